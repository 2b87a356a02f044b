#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <optional>
#include <span>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::detail {

/// Height of the ground around a keyframe over its body, metres, by the scans of a piece of path; none if hardly any of
/// it was seen. A scan alone may show none: a scanner that looks ahead sees the ground under it from elsewhere.
[[nodiscard]] [[gnu::cold]] inline std::optional<double> ground_height(std::span<const Keyframe> keyframes, Index at) {
  constexpr double reach = 5.0;  // metres
  constexpr Offset fewest = 20;  // points
  constexpr double share = 0.1;  // of the points around lie lower than the ground is taken to
  const Eigen::Vector3d center = keyframes[static_cast<std::size_t>(at)].T_odom_body.translation();
  Table<Ranked> heights;
  for (const Keyframe& keyframe : keyframes) {
    const auto cloud = keyframe.cloud.load();
    if (!cloud) continue;
    const SE3d T_center_body(keyframe.T_odom_body.rotation(), keyframe.T_odom_body.translation() - center);
    for (const Eigen::Vector3f& point : cloud->positions) {
      const Eigen::Vector3d p = T_center_body * point.cast<double>().eval();
      if (is_finite(p) && p.head<2>().norm() < reach) heights.push_back({p.z(), 0});
    }
  }
  if (heights.size() < fewest) return std::nullopt;
  sort_ranked(heights.all());
  return heights[static_cast<Offset>(share * static_cast<double>(heights.size()))].rank;
}

}  // namespace chainslam::detail
