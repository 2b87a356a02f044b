#pragma once

#include <vector>

#include "chainslam/slam/slam_map.hpp"

namespace chainslam::support {

/// A step of odometry between two keyframes that the finished map contradicts: closures or fixes hold the map together
/// there, in odometry's place.
struct OdometryFailure {
  double begin = 0, end = 0;  ///< seconds since the session's first keyframe
  double distance = 0;        ///< metres, by odometry
  double off = 0;             ///< metres that the map puts the second keyframe elsewhere, seen from the first
  double turned = 0;          ///< radians, the same
  double squared_error = 0;   ///< in variances of the step
};

/// @param threshold  squared error from which a step counts as failed: what it costs the back end to take it for one,
/// `GroupGnc::odometry`.
/// @returns those of one session, in the order of time.
[[nodiscard]] std::vector<OdometryFailure> odometry_failures(const SlamMap& map, const Session& session,
                                                             double threshold = 70.0);

}  // namespace chainslam::support
