#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "simulator/street_grid.hpp"

namespace chainslam::simulator {

/// Metres.
[[nodiscard]] inline double distance_to_street(const Eigen::Vector2d& point, const Street& street) {
  const Eigen::Vector2d along = street.to - street.from;
  const double part = std::clamp((point - street.from).dot(along) / along.squaredNorm(), 0.0, 1.0);
  return (point - street.from - part * along).norm();
}

/// A rectangle on the ground.
struct Plot {
  Eigen::Vector2d center;
  Eigen::Vector2d axis;  ///< unit vector along `half.x()`
  Eigen::Vector2d half;  ///< half width and half depth, metres

  [[nodiscard]] Eigen::Vector2d at(double x, double y) const {
    return center + x * half.x() * axis + y * half.y() * Eigen::Vector2d(-axis.y(), axis.x());
  }
  [[nodiscard]] double radius() const { return half.norm(); }
};

/// Whether `axes` of the first plot separate the two (one half of the separating axis test).
[[nodiscard]] inline bool separated_by_axes_of(const Plot& a, const Plot& b) {
  for (const int axis : {0, 1}) {
    const Eigen::Vector2d direction = axis == 0 ? a.axis : Eigen::Vector2d(-a.axis.y(), a.axis.x());
    const Eigen::Vector2d side(-b.axis.y(), b.axis.x());
    const double reach = b.half.x() * std::abs(b.axis.dot(direction)) + b.half.y() * std::abs(side.dot(direction));
    if (std::abs((b.center - a.center).dot(direction)) > a.half[axis] + reach) return true;
  }
  return false;
}

[[nodiscard]] inline bool overlap(const Plot& a, const Plot& b) {
  return !separated_by_axes_of(a, b) && !separated_by_axes_of(b, a);
}

}  // namespace chainslam::simulator
