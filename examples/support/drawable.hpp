#pragma once

#include <Eigen/Core>
#include <cmath>

#include "chainslam/core/types.hpp"

namespace chainslam::support {

/// Whether a number can be drawn: finite, and so small that differences, squares and float copies are finite as well.
/// 1e15 m is also where doubles begin to be coarser than a pixel.
[[nodiscard]] inline bool is_drawable(double value) { return is_finite(value) && std::abs(value) < 1e15; }
[[nodiscard]] inline bool is_drawable(const Eigen::Vector3d& p) {
  return is_drawable(p.x()) && is_drawable(p.y()) && is_drawable(p.z());
}

}  // namespace chainslam::support
