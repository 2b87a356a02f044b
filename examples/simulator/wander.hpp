#pragma once

#include "chainslam/core/random.hpp"
#include "simulator/street_grid.hpp"

namespace chainslam::simulator {

/// A part of the grid of crossings, corners included.
struct Window {
  Crossing low;
  Crossing high;
};

/// A walk of `streets` pieces of street that stays in the window, never turns back on the spot, and prefers streets
/// that it has not seen.
/// @param window  at least 2 x 2 crossings. @throws std::invalid_argument if it is smaller.
[[nodiscard]] Route wander(const Window& window, Index streets, Rng rng);

}  // namespace chainslam::simulator
