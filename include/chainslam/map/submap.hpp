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

/// The same, but for keyframes farther along the path from `center` than `max_length` metres; 0: however far.
[[nodiscard]] inline SubmapRange submap_range(std::span<const Keyframe> keyframes, KeyframeId center, Index radius,
                                              double max_length) {
  const SubmapRange all = submap_range(keyframes, center, radius);
  if (!(max_length > 0)) return all;
  const auto step = [&](Index from) {
    return (keyframes[static_cast<std::size_t>(from + 1)].T_odom_body.translation() -
            keyframes[static_cast<std::size_t>(from)].T_odom_body.translation())
        .norm();
  };
  SubmapRange range{center.value, center.value + 1};
  double before = 0, after = 0;
  while (range.begin > all.begin && (before += step(range.begin - 1)) <= max_length) --range.begin;
  while (range.end < all.end && (after += step(range.end - 1)) <= max_length) ++range.end;
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

/// Adds `more` to `points`, normals on the side that is seen from the origin.
inline void append_seen_from_origin(PointCloud<float>& points, const PointCloud<float>& more) {
  points.positions.insert(points.positions.end(), more.positions.begin(), more.positions.end());
  for (std::size_t i = 0; i < more.normals.size(); ++i) {
    const Eigen::Vector3f &n = more.normals[i], &p = more.positions[i];
    const bool away = n[0] * p[0] + n[1] * p[1] + n[2] * p[2] > 0;
    points.normals.emplace_back(away ? -n[0] : n[0], away ? -n[1] : n[1], away ? -n[2] : n[2]);
  }
}

}  // namespace chainslam
