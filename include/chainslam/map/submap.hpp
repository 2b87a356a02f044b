#pragma once

#include <algorithm>
#include <cassert>
#include <span>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/cloud/transform.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/map/keyframe.hpp"

namespace chainslam {

/// Consecutive keyframes [begin, end) of one session.
struct SubmapRange {
  Index begin = 0;
  Index end = 0;
  friend bool operator==(const SubmapRange&, const SubmapRange&) = default;
};

/// Keyframes within `radius` indices of `center`, of the same session: at most 2 radius + 1.
///
/// @param keyframes  all keyframes of the map; ids are positions.
[[nodiscard]] inline SubmapRange submap_range(std::span<const Keyframe> keyframes, KeyframeId center, Index radius) {
  const auto at = [&](Index i) -> const Keyframe& { return keyframes[static_cast<std::size_t>(i)]; };
  assert(center.valid() && center.value < static_cast<Index>(keyframes.size()));
  SubmapRange range{center.value, center.value + 1};
  const SessionId session = at(center.value).session;
  while (range.begin > 0 && range.begin > center.value - radius && at(range.begin - 1).session == session)
    --range.begin;
  const Index last = static_cast<Index>(keyframes.size());
  while (range.end < last && range.end <= center.value + radius && at(range.end).session == session) ++range.end;
  return range;
}

/// The scans of `range`, placed by their optimised poses and seen from `center`'s body, thinned to one point per voxel.
///
/// @param voxel_size  metres.
/// @returns points in the body frame of `center`, metres.
[[nodiscard]] inline PointCloud<float> assemble_submap(std::span<const Keyframe> keyframes, KeyframeId center,
                                                       SubmapRange range, double voxel_size) {
  PointCloud<float> points;
  const SE3d T_center_map = keyframes[static_cast<std::size_t>(center.value)].T_map_body.inverse();
  for (const Keyframe& keyframe :
       keyframes.subspan(static_cast<std::size_t>(range.begin), static_cast<std::size_t>(range.end - range.begin))) {
    if (!keyframe.cloud) continue;
    const PointCloud<float> seen = transformed(keyframe.cloud->positions, T_center_map * keyframe.T_map_body);
    const std::size_t before = points.positions.size();
    points.positions.resize(before + seen.positions.size());
    std::copy_n(seen.positions.data(), seen.positions.size(), points.positions.data() + before);
  }
  return voxel_downsample(points, voxel_size);
}

}  // namespace chainslam
