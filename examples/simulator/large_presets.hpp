#pragma once

#include "simulator/preset.hpp"

namespace chainslam::simulator {

// See `preset`.

[[nodiscard]] Preset nclt_like(PresetSize size);
[[nodiscard]] Preset mars_like(PresetSize size);

}  // namespace chainslam::simulator
