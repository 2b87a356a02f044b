#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>

#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// Calls `take(x, y, share)` for each cell that a line passes between two points, in their order, but the last one's:
/// `share` is how much of the line lies before the middle of what is in the cell (Amanatides and Woo 1987).
/// @param from  in units of cells, as `to`; neither is negative
template <class Take>
void for_each_cell_between(const Eigen::Vector2d& from, const Eigen::Vector2d& to, const Take& take) {
  constexpr double never = std::numeric_limits<double>::infinity();
  Index cell[2], step[2], left[2];
  double next[2], each[2];  // shares of the line at which it enters the next cell, and that it takes for one
  for (int k = 0; k < 2; ++k) {
    const double along = to[k] - from[k];
    cell[k] = static_cast<Index>(from[k]);
    step[k] = along < 0 ? -1 : 1;
    each[k] = along == 0 ? never : 1 / std::abs(along);
    const double edge = along < 0 ? from[k] - std::floor(from[k]) : std::floor(from[k]) + 1 - from[k];
    next[k] = along == 0 ? never : edge * each[k];
    left[k] = std::abs(static_cast<Index>(to[k]) - cell[k]);
  }
  for (double entered = 0; left[0] + left[1] > 0;) {
    const int k = left[1] == 0 || (left[0] > 0 && next[0] < next[1]) ? 0 : 1;
    take(cell[0], cell[1], 0.5 * (entered + std::min(next[k], 1.0)));
    entered = next[k];
    cell[k] += step[k];
    --left[k];
    next[k] += each[k];
  }
}

}  // namespace chainslam::detail
