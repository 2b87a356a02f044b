#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <span>
#include <stdexcept>
#include <tuple>
#include <utility>
#include <vector>

#include "binary_keypoints.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/search/kd_tree.hpp"

namespace chainslam {

/// Which triangles of keypoints describe a place. Defaults: LAMM's configuration for NCLT.
struct TriangleOptions {
  Index nearest = 15;       ///< keypoints that are joined with one another around each, itself counted
  double min_side = 1.0;    ///< metres
  double max_side = 30.0;   ///< metres
  double min_excess = 0.2;  ///< metres by which two sides together exceed the third: flatter ones are left out
};

/// A triangle of keypoints. Its sides are the same wherever the place is seen from.
struct Triangle {
  Eigen::Vector3f sides{0, 0, 0};  ///< a <= b <= c, metres
  /// Places of its corners among the keypoints: between a and b, between a and c, between b and c.
  std::array<std::uint16_t, 3> corners{};
};

namespace detail {

/// The triangle of three keypoints, its sides in order.
[[nodiscard]] inline Triangle triangle_of(std::span<const BinaryKeypoint> keypoints,
                                          const std::array<std::uint16_t, 3>& corners) {
  const auto length = [&](int i, int j) {
    return (keypoints[corners[static_cast<std::size_t>(i)]].position -
            keypoints[corners[static_cast<std::size_t>(j)]].position)
        .norm();
  };
  // Each side with the corner that it does not touch.
  std::array<std::pair<float, std::uint16_t>, 3> sides{
      {{length(1, 2), corners[0]}, {length(0, 2), corners[1]}, {length(0, 1), corners[2]}}};
  std::ranges::sort(sides);
  return {.sides = {sides[0].first, sides[1].first, sides[2].first},
          .corners = {sides[2].second, sides[1].second, sides[0].second}};
}

[[nodiscard]] inline bool is_usable(const Triangle& triangle, const TriangleOptions& options) {
  const auto [a, b, c] = std::tuple(static_cast<double>(triangle.sides[0]), static_cast<double>(triangle.sides[1]),
                                    static_cast<double>(triangle.sides[2]));
  return a >= options.min_side && c <= options.max_side && a + b - c >= options.min_excess;
}

/// All sets of three of what is nearest to each keypoint, itself among them; each once.
[[nodiscard]] inline std::vector<std::array<std::uint16_t, 3>> corner_sets(std::span<const BinaryKeypoint> keypoints,
                                                                           Index nearest) {
  std::vector<Eigen::Vector3f> positions;
  for (const BinaryKeypoint& keypoint : keypoints) positions.push_back(keypoint.position);
  const KdTree<float> tree(positions);
  std::vector<Neighbor<float>> found(static_cast<std::size_t>(std::max<Index>(nearest, 1)));
  std::vector<std::array<std::uint16_t, 3>> sets;
  for (std::size_t i = 0; i < keypoints.size(); ++i) {
    const auto count = static_cast<std::size_t>(tree.knn(positions[i], found));
    for (std::size_t m = 0; m < count; ++m)
      for (std::size_t n = m + 1; n < count; ++n) {
        std::array<std::uint16_t, 3> set{static_cast<std::uint16_t>(i), static_cast<std::uint16_t>(found[m].index),
                                         static_cast<std::uint16_t>(found[n].index)};
        std::ranges::sort(set);
        if (set[0] != set[1] && set[1] != set[2]) sets.push_back(set);
      }
  }
  std::ranges::sort(sets);
  sets.erase(std::unique(sets.begin(), sets.end()), sets.end());
  return sets;
}

}  // namespace detail

/// The triangles of keypoints that are near one another (Yuan et al. 2023, STD): the same for any motion of the
/// keypoints and any order of them, but for the numbers of the corners.
/// @throws std::invalid_argument for more than 65535 keypoints.
[[nodiscard]] inline std::vector<Triangle> triangles_of(std::span<const BinaryKeypoint> keypoints,
                                                        const TriangleOptions& options = {}) {
  if (keypoints.size() > std::numeric_limits<std::uint16_t>::max())
    throw std::invalid_argument("triangles_of: more keypoints than a triangle can number");
  std::vector<Triangle> triangles;
  for (const auto& corners : detail::corner_sets(keypoints, options.nearest)) {
    const Triangle triangle = detail::triangle_of(keypoints, corners);
    if (detail::is_usable(triangle, options)) triangles.push_back(triangle);
  }
  return triangles;
}

}  // namespace chainslam
