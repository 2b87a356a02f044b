#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <tuple>
#include <utility>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/cloud/quantize.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// A unit vector on the octahedron |x| + |y| + |z| = 1, unfolded to a square: 16 bits for each side, off by 0.004
/// degrees at most (Cigolle et al. 2014, "A survey of efficient representations for independent unit vectors").
struct OctahedralNormal {
  static constexpr std::int16_t none = -32768;  ///< stands for the zero vector

  std::array<std::int16_t, 2> side{none, none};

  OctahedralNormal() = default;
  explicit OctahedralNormal(const Eigen::Vector3f& n) {
    const float sum = std::abs(n[0]) + std::abs(n[1]) + std::abs(n[2]);
    if (!(sum > 0)) return;
    const float u = n[0] / sum, v = n[1] / sum;
    side = n[2] < 0 ? std::array{rounded(folded(v, u)), rounded(folded(u, v))} : std::array{rounded(u), rounded(v)};
  }

  [[nodiscard]] Eigen::Vector3f vector() const {
    if (side[0] == none) return Eigen::Vector3f::Zero();
    float u = static_cast<float>(side[0]) / most, v = static_cast<float>(side[1]) / most;
    const float w = 1.0F - std::abs(u) - std::abs(v);
    if (w < 0) std::tie(u, v) = std::pair(folded(v, u), folded(u, v));
    const float scale = 1.0F / std::sqrt(u * u + v * v + w * w);
    return {scale * u, scale * v, scale * w};
  }

 private:
  static constexpr float most = 32767.0F;
  [[nodiscard]] static std::int16_t rounded(float value) {
    return static_cast<std::int16_t>(std::lround(value * most));
  }
  /// How a coordinate of the lower half lies outside of the upper half's square.
  [[nodiscard]] static float folded(float other, float own) { return std::copysign(1.0F - std::abs(other), own); }
};

/// Points with normals in 10 bytes each instead of 24: positions rounded to `step` or, for points beyond 163 m, a
/// multiple of it (see `PositionGrid`).
class PackedSurface {
 public:
  static constexpr double step = 0.005;  ///< metres: half of what scans are rounded to

  explicit PackedSurface(const PointCloud<float>& cloud) : grid_(grid_reaching(cloud, step)) {
    points_.reserve(to_index(cloud.size()));
    for (std::size_t i = 0; i < cloud.size(); ++i) {
      const Eigen::Vector3d p = position(cloud, i);
      const auto x = grid_.nearest(p[0]), y = grid_.nearest(p[1]), z = grid_.nearest(p[2]);
      if (x && y && z) points_.push_back({{*x, *y, *z}, OctahedralNormal(cloud.normals[i])});
    }
  }

  [[nodiscard]] PointCloud<float> unpacked() const {
    PointCloud<float> cloud;
    cloud.positions.reserve(static_cast<std::size_t>(points_.size()));
    cloud.normals.reserve(static_cast<std::size_t>(points_.size()));
    for (const Point& point : points_) {
      const auto at = [&](std::size_t axis) { return grid_.coordinate(point.position[axis]); };
      cloud.positions.emplace_back(at(0), at(1), at(2));
      cloud.normals.push_back(point.normal.vector());
    }
    return cloud;
  }

  [[nodiscard]] std::size_t bytes() const { return static_cast<std::size_t>(points_.size()) * sizeof(Point); }

 private:
  struct Point {
    std::array<std::int16_t, 3> position{};
    OctahedralNormal normal{};
  };

  PositionGrid grid_;
  Table<Point> points_;
};

}  // namespace chainslam::detail
