#pragma once

#include <memory>

#include "chainslam/slam/slam_map.hpp"
#include "generated/hall.hpp"

namespace generated {

/// Adds a keyframe with its scan, and the odometry that leads to it.
inline void grow(SlamMap& map, Rng& rng) {
  const auto id = static_cast<Index>(map.keyframes.size());
  if (id == 0) map.sessions.push_back({.id = SessionId{0}, .name = "morning", .frame = SessionId{0}});
  const SE3d step(SO3d(), {1.0, 0, 0}), T_odom_body(SO3d(), {1.0 * id, 0, 0});
  map.keyframes.push_back(
      {.id = KeyframeId{id},
       .session = SessionId{0},
       .time = Timestamp::from_seconds(id),
       .T_odom_body = T_odom_body,
       .T_map_body = T_odom_body,
       .cloud = std::make_shared<const PointCloud<float>>(generated::scan(generated::upright(-10.0 + id, 3, 0), rng))});
  if (id > 0) map.odometry.push_back({KeyframeId{id - 1}, KeyframeId{id}, step, SqrtInformation<6>::Identity()});
  map.sessions.back().keyframes = id + 1;
}

}  // namespace generated
