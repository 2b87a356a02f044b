#pragma once

#include <utility>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/features/oriented_on_demand.hpp"
#include "chainslam/registration/icp.hpp"

namespace chainslam {

/// Aligns two clouds in one go: indexes the target and estimates its normals where they are needed. Keep an
/// `IndexedCloud` where several sources meet one target, and make large clouds smaller with `voxel_downsample`.
template <Cloud Source, Cloud Target, Executor Exec = Serial>
  requires(!NearestNeighborSearch<Target>)
[[nodiscard]] AlignResult align(const Source& source, const Target& target, const SE3d& guess = {},
                                const Exec& executor = {}) {
  PointCloud<float> points;
  points.positions.reserve(cloud_size(target));
  for (std::size_t i = 0; i < cloud_size(target); ++i) points.positions.push_back(position_f(target, i));
  return detail::robust_to_planes.align(source, OrientedOnDemand(std::move(points)), guess, executor);
}

}  // namespace chainslam
