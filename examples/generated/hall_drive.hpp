#pragma once

#include <memory>
#include <vector>

#include "chainslam/slam/slam_map.hpp"
#include "generated/hall.hpp"

namespace generated {

/// A drive along the hall and back, whose odometry turns slowly the wrong way.
inline std::vector<Keyframe> hall_drive(double y, double yaw_drift, std::uint64_t seed) {
  std::vector<Keyframe> keyframes;
  Rng rng(seed);
  SE3d T_odom_body, last;
  for (int i = 0; i < 44; ++i) {
    const SE3d T_hall_body = i < 22 ? generated::upright(i - 10.5, y, 0) : generated::upright(32.5 - i, y + 0.5, 3.1);
    const SE3d drift(SO3d::exp({0, 0, yaw_drift}), {0.005, 0, 0});
    if (i > 0) T_odom_body = T_odom_body * last.inverse() * T_hall_body * drift;
    last = T_hall_body;
    const Eigen::Vector3d p = T_hall_body.translation();  // on the equator: x is up, y is east, z is north
    keyframes.push_back({.time = Timestamp::from_seconds(i),
                         .T_odom_body = T_odom_body,
                         .cloud = std::make_shared<const PointCloud<float>>(generated::scan(T_hall_body, rng)),
                         .gnss = GnssFix{.time = Timestamp::from_seconds(i),
                                         .position_ecef = {6378137.0, p.x() + rng.normal(), p.y() + rng.normal()},
                                         .quality = GnssQuality::three_dimensional}});
  }
  return keyframes;
}

}  // namespace generated
