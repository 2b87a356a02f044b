#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// How far one sees from a viewpoint in each direction, on the six faces of a cube: no direction is a pole, and no
/// angle is computed.
class RangeImage {
 public:
  /// @param cell  edge, radians, in the middle of a face.
  template <Cloud Points>
  RangeImage(const Points& points, const Eigen::Vector3d& viewpoint, double cell)
      : viewpoint_(viewpoint), cells_(std::max(4, static_cast<int>(std::ceil(2.0 / cell)))) {
    const auto count = static_cast<std::size_t>(cells_) * static_cast<std::size_t>(cells_) * 6;
    nearest_.assign(count, unknown);
    for (std::size_t i = 0; i < cloud_size(points); ++i) {
      const Eigen::Vector3d ray = position(points, i) - viewpoint_;
      const double range = ray.norm();
      if (!is_finite(range) || !(range > 0)) continue;
      const Cell at = cell_of(ray);
      nearest_[place(at)] = std::min(nearest_[place(at)], range);
    }
  }

  /// The distance to the nearest thing seen in the direction of a point or beside it; infinite if nothing was seen in
  /// that direction itself.
  [[nodiscard]] double free_range(const Eigen::Vector3d& point) const {
    const Eigen::Vector3d ray = point - viewpoint_;
    if (!is_finite(ray.norm()) || !(ray.norm() > 0)) return unknown;
    const Cell at = cell_of(ray);
    if (nearest_[place(at)] == unknown) return unknown;
    double least = unknown;
    for (int row = std::max(at.row - 1, 0); row <= std::min(at.row + 1, cells_ - 1); ++row)
      for (int column = std::max(at.column - 1, 0); column <= std::min(at.column + 1, cells_ - 1); ++column)
        least = std::min(least, nearest_[place({at.face, row, column})]);
    return least;
  }
  [[nodiscard]] double range_of(const Eigen::Vector3d& point) const { return (point - viewpoint_).norm(); }

  static constexpr double unknown = std::numeric_limits<double>::infinity();

 private:
  struct Cell {
    int face, row, column;
  };

  [[nodiscard]] Cell cell_of(const Eigen::Vector3d& ray) const {
    Eigen::Index axis = 0;
    const double length = ray.cwiseAbs().maxCoeff(&axis);
    const auto step = [&](Eigen::Index other) {
      const double share = 0.5 * (ray[(axis + other) % 3] / length + 1.0);
      return std::clamp(static_cast<int>(share * cells_), 0, cells_ - 1);
    };
    return {static_cast<int>(2 * axis) + (ray[axis] < 0 ? 1 : 0), step(1), step(2)};
  }
  [[nodiscard]] std::size_t place(const Cell& cell) const {
    return static_cast<std::size_t>((cell.face * cells_ + cell.row) * cells_ + cell.column);
  }

  Eigen::Vector3d viewpoint_;
  int cells_;
  std::vector<double> nearest_;
};

}  // namespace chainslam::detail
