#pragma once

#include <vector>

#include "simulator/preset.hpp"

namespace chainslam::simulator {

// See `preset`.

[[nodiscard]] Preset nclt_like(PresetSize size);
[[nodiscard]] Preset mars_like(PresetSize size);

/// Five walks of so many streets through overlapping parts of a grid, each over two thirds of it, on days of a year.
[[nodiscard]] std::vector<SessionPlan> walks(Index columns, Index rows, Index streets);

}  // namespace chainslam::simulator
