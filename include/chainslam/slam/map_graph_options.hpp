#pragma once

#include "chainslam/factor_graph/smoother_reports.hpp"
#include "chainslam/slam/georeference.hpp"
#include "chainslam/slam/odometry_doubt.hpp"
#include "chainslam/slam/odometry_noise.hpp"

namespace chainslam {

/// Of the pose graph over the keyframes.
struct MapGraphOptions {
  OdometryNoise odometry_noise{};                             ///< what odometry's measurements weigh
  OdometryNoise unknown_odometry = unknown_odometry_noise();  ///< where frames have no covariance, as recorded ones
  OdometryDoubt odometry_doubt{};  ///< where frames between two keyframes were lost or degenerate
  /// Standard deviation of the prior that holds a frame's first keyframe, metres and radians.
  double anchor = 1e-4;
  /// Whether a session that a merge joins to another frame is held there, at its aligned start, by a prior as tight
  /// (the paper); else closures alone tie it to the others.
  bool anchor_joined_sessions = false;
  /// Whether measurements of a loaded map, and of sessions before the one that begins, are replaced by what their poses
  /// say, as by the released code, which saves and loads each: no residuals are left, and what is known counts twice.
  bool remeasure_loaded = false;
  GnssFactorOptions gnss{};  ///< for `GroupGnc`
  /// How near each optimization comes to the optimum. Without patience, since it goes on until nothing waits, and
  /// without a lag, since closures may reach any keyframe.
  SmootherOptions smoother{.patience = 0.0};
  /// How near the last one does. Its iterations also bound the updates of the others.
  ConvergeOptions<NoRestart> optimizer{.max_iterations = 50, .relative_tolerance = 1e-6};
};

}  // namespace chainslam
