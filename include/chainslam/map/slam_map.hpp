#pragma once

#include <vector>

#include "chainslam/map/keyframe.hpp"
#include "chainslam/map/loop_closure.hpp"
#include "chainslam/map/session.hpp"

namespace chainslam {

/// Relative pose of two consecutive keyframes of a session, as odometry measured it.
struct OdometryMeasurement {
  KeyframeId from;
  KeyframeId to;
  SE3d T_from_to;
  Matrix6d covariance = Matrix6d::Identity();  ///< tangent [translation; rotation]
};

/// All that mapping found out: sessions, keyframes (ids are positions in `keyframes`) and what connects them.
struct SlamMap {
  std::vector<Session> sessions;
  std::vector<Keyframe> keyframes;
  std::vector<OdometryMeasurement> odometry;
  std::vector<LoopClosure> closures;  ///< accepted
  std::vector<LoopClosure> refusals;  ///< tried and refused
};

}  // namespace chainslam
