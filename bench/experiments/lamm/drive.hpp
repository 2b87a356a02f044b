#pragma once

#include <memory>
#include <string>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam::lamm {

/// A scan that was kept, and which frame of odometry it is of.
struct Scan {
  Index frame = 0;
  std::shared_ptr<const PointCloud<float>> cloud{};  ///< body frame, corrected for motion
};

/// One session as odometry left it.
struct Drive {
  std::string name;
  Trajectory odometry;      ///< T_odom_body of every frame
  std::vector<Scan> scans;  ///< of some of the frames, in their order

  [[nodiscard]] const SE3d& pose(Index frame) const { return odometry.poses[static_cast<std::size_t>(frame)]; }
  [[nodiscard]] Index frames() const { return to_index(odometry.poses.size()); }
};

}  // namespace chainslam::lamm
