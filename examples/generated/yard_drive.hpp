#pragma once

#include <vector>

#include "chainslam/sensor/frame.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "generated/hall.hpp"

namespace generated {

/// Where a drive through the hall is after so many metres: along it and back on the other side.
inline SE3d yard_pose(double travelled, double y) {
  return travelled < 22 ? upright(travelled - 11, y, 0) : upright(33 - travelled, y + 1.0, 3.1);
}

/// A drive of 44 m through the hall without its roof, with a scan each metre; odometry begins anywhere and drifts.
/// @param T_odom_start  where odometry has its start.
inline std::vector<Frame> yard_drive(double y, const SE3d& T_odom_start, std::uint64_t seed) {
  std::vector<Frame> frames;
  Rng rng(seed);
  SE3d T_odom_body = T_odom_start, last;
  for (int i = 0; i < 44; ++i) {
    const SE3d T_hall_body = yard_pose(i, y);
    const SE3d drift(SO3d::exp({0, 0, 0.0005}), {0.005, 0, 0});
    if (i > 0) T_odom_body = T_odom_body * last.inverse() * T_hall_body * drift;
    last = T_hall_body;
    Frame frame;
    frame.time = Timestamp::from_seconds(i);
    frame.T_odom_body = T_odom_body;
    frame.covariance *= 1e-4;
    for (const Eigen::Vector3f& p : scan(T_hall_body, rng).positions)
      if (p.z() < 3) frame.cloud.positions.push_back(p);
    frames.push_back(frame);
  }
  return frames;
}

}  // namespace generated
