#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <optional>
#include <utility>
#include <vector>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::mapper {

/// The points that a file of some sessions' scans holds: of each voxel the first, or all if the size is 0. They are
/// chosen once, with one bit for each point of the scans, and gone through as often as it takes. One scan at a time is
/// in memory.
class PlacedPoints {
 public:
  /// @param map  is referred to.
  PlacedPoints(const SlamMap& map, std::vector<SessionId> sessions, double voxel_size)
      : map_(map), sessions_(std::move(sessions)) {
    CellSet occupied;
    for_each_scan([&](const Keyframe&, const PointCloud<float>&, const PointCloud<float>& placed) {
      for (const Eigen::Vector3f& position : placed.positions) {
        std::optional<Cell> cell;
        if (voxel_size > 0) cell = cell_of(position.cast<double>() * (1.0 / voxel_size));
        chosen_.push_back(!(voxel_size > 0) || (cell && occupied.insert(*cell)));
        count_ += chosen_.back();
      }
    });
  }

  [[nodiscard]] std::size_t size() const { return count_; }

  /// Calls `take(keyframe, cloud, i, position)` for each of them, placed by T_map_body.
  template <class Take>
  void for_each(const Take& take) const {
    std::size_t number = 0;
    for_each_scan([&](const Keyframe& keyframe, const PointCloud<float>& cloud, const PointCloud<float>& placed) {
      for (std::size_t i = 0; i < placed.size(); ++i)
        if (chosen_[number++]) take(keyframe, cloud, i, placed.positions[i]);
    });
  }

 private:
  template <class Visit>
  void for_each_scan(const Visit& visit) const {
    for (const SessionId id : sessions_) {
      const Session& session = map_.sessions[static_cast<std::size_t>(id.value)];
      for (Index k = session.first_keyframe; k < session.end_keyframe(); ++k) {
        const Keyframe& keyframe = map_.keyframes[static_cast<std::size_t>(k)];
        if (!keyframe.cloud) continue;
        const KeyframeScan::Cloud cloud = keyframe.cloud.load();
        visit(keyframe, *cloud, transformed(cloud->positions, keyframe.T_map_body));
      }
    }
  }

  const SlamMap& map_;
  std::vector<SessionId> sessions_;
  std::vector<bool> chosen_;  ///< of each point of the scans
  std::size_t count_ = 0;
};

}  // namespace chainslam::mapper
