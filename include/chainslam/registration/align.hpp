#pragma once

#include <utility>

#include "chainslam/cloud/columns.hpp"
#include "chainslam/cloud/concepts.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/features/oriented_on_demand.hpp"
#include "chainslam/registration/icp.hpp"

namespace chainslam {

namespace detail {

template <Cloud T>
[[nodiscard]] PointCloud<float> copy_positions(const T& cloud) {
  PointCloud<float> points;
  points.positions.reserve(cloud_size(cloud));
  for (std::size_t i = 0; i < cloud_size(cloud); ++i) points.positions.push_back(position_f(cloud, i));
  return points;
}

template <class T>
struct PlainCloud {
  /// The points with the cloud's own normals, or with estimated ones.
  template <class Exec>
  [[nodiscard]] static PointCloud<float> oriented(const T& cloud, const Exec& executor) {
    PointCloud<float> points = copy_positions(cloud);
    if constexpr (OrientedCloud<T>) {
      if (carries_normals(cloud)) {
        points.normals.reserve(points.size());
        for (std::size_t i = 0; i < points.size(); ++i)
          points.normals.push_back(normal(cloud, i).template cast<float>());
        return points;
      }
    }
    (void)estimate_normals(points, NormalOptions{.neighbors = 10}, Eigen::Vector3d::Zero(), executor);
    return points;
  }
  template <class Exec>
  [[nodiscard]] static IndexedCloud<> indexed(const T& cloud, bool with_normals, const Exec& executor) {
    return IndexedCloud<>(with_normals ? oriented(cloud, executor) : copy_positions(cloud));
  }
};

}  // namespace detail

/// Aligns two clouds in one go: indexes the target and estimates its normals where they are needed. Keep an
/// `IndexedCloud` where several sources meet one target, and make large clouds smaller with `voxel_downsample`.
template <Cloud Source, Cloud Target, Executor Exec = Serial>
  requires(!NearestNeighborSearch<Target>)
[[nodiscard]] AlignResult align(const Source& source, const Target& target, const SE3d& guess = {},
                                const Exec& executor = {}) {
  return detail::robust_to_planes.align(source, OrientedOnDemand(detail::copy_positions(target)), guess, executor);
}

}  // namespace chainslam
