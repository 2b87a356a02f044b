#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <optional>
#include <vector>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::mapper {

/// Calls `take(keyframe, cloud, i, position)` for the scans' points of some sessions, placed by T_map_body: of each
/// voxel the first, or all if the size is 0. One scan at a time is in memory, and the voxels that are occupied.
template <class Take>
void for_each_placed_point(const SlamMap& map, const std::vector<SessionId>& sessions, double voxel_size,
                           const Take& take) {
  CellSet occupied;
  for (const SessionId id : sessions) {
    const Session& session = map.sessions[static_cast<std::size_t>(id.value)];
    for (Index k = session.first_keyframe; k < session.end_keyframe(); ++k) {
      const Keyframe& keyframe = map.keyframes[static_cast<std::size_t>(k)];
      if (!keyframe.cloud) continue;
      const KeyframeScan::Cloud cloud = keyframe.cloud.load();
      const PointCloud<float> placed = transformed(cloud->positions, keyframe.T_map_body);
      for (std::size_t i = 0; i < placed.size(); ++i) {
        if (voxel_size > 0) {
          const std::optional<Cell> cell = cell_of(placed.positions[i].cast<double>() * (1.0 / voxel_size));
          if (!cell || !occupied.insert(*cell)) continue;
        }
        take(keyframe, *cloud, i, placed.positions[i]);
      }
    }
  }
}

}  // namespace chainslam::mapper
