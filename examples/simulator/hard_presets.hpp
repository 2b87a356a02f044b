#pragma once

#include "simulator/preset.hpp"

namespace chainslam::simulator {

/// See `preset`.
/// @{
[[nodiscard]] Preset nclt_hard(PresetSize size);
[[nodiscard]] Preset mars_hard(PresetSize size);
/// @}

}  // namespace chainslam::simulator
