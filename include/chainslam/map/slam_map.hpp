#pragma once

#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/map/frame_record.hpp"
#include "chainslam/map/keyframe.hpp"
#include "chainslam/map/loop_closure.hpp"
#include "chainslam/map/session.hpp"

namespace chainslam {

/// Relative pose of two consecutive keyframes of a session, as odometry measured it.
struct OdometryMeasurement {
  KeyframeId from{};                                                  ///< the earlier keyframe
  KeyframeId to{};                                                    ///< the later keyframe
  SE3d T_from_to{};                                                   ///< as odometry measured it
  SqrtInformation<6> sqrt_information = zeros<SqrtInformation<6>>();  ///< tangent [translation; rotation]
};

/// All that mapping found out: sessions, keyframes (ids are positions in `keyframes`) and what connects them.
///
/// Measurements are kept as they were made, so that a map that is loaded has the optimum that it had when it was saved.
struct SlamMap {
  std::vector<Session> sessions;              ///< in the order in which they were driven
  std::vector<Keyframe> keyframes;            ///< all sessions' one after the other
  std::vector<OdometryMeasurement> odometry;  ///< between consecutive keyframes
  /// Accepted once, in the order in which they were; the verdict says what has become of them since.
  std::vector<LoopClosure> closures;
  std::vector<LoopClosure> refusals;  ///< tried and refused
  /// Every frame of odometry, session by session, in the order of time. Maps made without them have none.
  std::vector<FrameRecord> frames;
};

}  // namespace chainslam
