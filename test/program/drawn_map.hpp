#pragma once

#include <Eigen/Core>
#include <cmath>
#include <memory>
#include <numbers>
#include <utility>

#include "chainslam/core/random.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::test {

/// A map without odometry or closures: keyframes on a circle in a square room of 40 m, on level ground.
/// @param sessions  that share a frame; a further one has a frame of its own
inline SlamMap drawn_map(int sessions, bool apart, Timestamp start, int keyframes = 24) {
  SlamMap map;
  Rng rng(1);
  for (Index s = 0; s < sessions + (apart ? 1 : 0); ++s) {
    const SessionId frame{s < sessions ? 0 : s};
    map.sessions.push_back({.id = SessionId{s},
                            .name = "drive " + std::to_string(s),
                            .first_keyframe = to_index(map.keyframes.size()),
                            .keyframes = keyframes,
                            .frame = frame});
    for (int i = 0; i < keyframes; ++i) {
      Keyframe keyframe{.id = KeyframeId{to_index(map.keyframes.size())}, .session = SessionId{s}};
      keyframe.time = start + seconds(1.5 * i + 1000 * s);
      const double angle = 2 * std::numbers::pi * i / keyframes + 0.1 * s;
      keyframe.T_odom_body = keyframe.T_map_body =
          SE3d(SO3d::exp({0, 0, angle}), {16 * std::cos(angle), 16 * std::sin(angle), 1.5});
      auto cloud = std::make_shared<PointCloud<float>>();
      for (int k = 0; k < 400; ++k) {
        const double along = rng.uniform(-20, 20), wall = rng.uniform() < 0.5 ? 20 : -20;
        Eigen::Vector3d p = rng.uniform() < 0.5 ? Eigen::Vector3d(along, wall, 0) : Eigen::Vector3d(wall, along, 0);
        if (rng.uniform() < 0.4)
          p = {rng.uniform(-19, 19), rng.uniform(-19, 19), 0};
        else
          p.z() = rng.uniform(0, 3);
        cloud->positions.push_back((keyframe.T_map_body.inverse() * p).cast<float>());
        cloud->intensities.push_back(static_cast<float>(k) / 400);
        cloud->time_offsets.push_back(static_cast<float>(k) / 4000 - 0.05F);
      }
      keyframe.cloud = std::move(cloud);
      map.keyframes.push_back(keyframe);
    }
  }
  return map;
}

}  // namespace chainslam::test
