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
  Index begin = 0;                                                           ///< first keyframe
  Index end = 0;                                                             ///< behind the last keyframe
  friend bool operator==(const SubmapRange&, const SubmapRange&) = default;  ///< whether all members are equal
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
    const auto cloud = keyframe.cloud.load();
    if (!cloud) continue;
    const PointCloud<float> seen = transformed(cloud->positions, T_center_map * keyframe.T_map_body);
    const std::size_t before = points.positions.size();
    points.positions.resize(before + seen.positions.size());
    std::copy_n(seen.positions.data(), seen.positions.size(), points.positions.data() + before);
  }
  return voxel_downsample(points, voxel_size);
}

/// Adds `more`, seen from frame a, to `points`; normals on the side that is seen from a's origin.
[[gnu::noinline]] inline void append_seen_from(const SE3d& T_a_b, const PointCloud<float>& more,
                                               PointCloud<float>& points) {
  const Eigen::Matrix3d R = T_a_b.rotation().matrix();
  const Eigen::Vector3d& t = T_a_b.translation();
  const std::size_t before = points.size();
  points.positions.resize(before + more.size());
  points.normals.resize(before + more.size());
  for (std::size_t i = 0; i < more.size(); ++i) {
    double p[3], n[3], away = 0;
    for (int k = 0; k < 3; ++k) {
      p[k] = t[k];
      n[k] = 0;
      for (int l = 0; l < 3; ++l) {
        p[k] += R(k, l) * static_cast<double>(more.positions[i][l]);
        n[k] += R(k, l) * static_cast<double>(more.normals[i][l]);
      }
      away += n[k] * p[k];
    }
    for (int k = 0; k < 3; ++k) {
      points.positions[before + i][k] = static_cast<float>(p[k]);
      points.normals[before + i][k] = static_cast<float>(away > 0 ? -n[k] : n[k]);
    }
  }
}

}  // namespace chainslam
