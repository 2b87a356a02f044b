#pragma once

#include <cstddef>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/sensor/packet.hpp"
#include "simulator/town_drive.hpp"

namespace chainslam::bench {

/// A simulated sweep in the body frame at its end, corrected by the true motion.
[[nodiscard]] inline PointCloud<float> corrected_sweep(const simulator::TownDrive& drive, Index index,
                                                       const SE3d& T_body_lidar) {
  constexpr double step = 5e-4;  // seconds: 5 mm at 10 m/s
  const LidarScan scan = drive.scan(index);
  const SE3d T_body_map = drive.truth(scan.end).inverse();
  std::vector<SE3d> poses;  // T_body_lidar at every step
  for (double t = 0; t <= to_seconds(scan.end - scan.time) + step; t += step)
    poses.push_back(T_body_map * drive.truth(scan.time + seconds(t)) * T_body_lidar);
  PointCloud<float> cloud;
  for (std::size_t i = 0; i < scan.cloud.size(); ++i) {
    const auto at = static_cast<std::size_t>(static_cast<double>(scan.cloud.time_offsets[i]) / step);
    cloud.positions.push_back((poses[at] * scan.cloud.positions[i].cast<double>()).cast<float>());
  }
  return cloud;
}

}  // namespace chainslam::bench
