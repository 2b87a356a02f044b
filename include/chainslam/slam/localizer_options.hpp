#pragma once

#include "chainslam/slam/keyframe_selector.hpp"
#include "chainslam/slam/odometry_doubt.hpp"
#include "chainslam/slam/odometry_noise.hpp"
#include "chainslam/slam/place_candidates.hpp"
#include "chainslam/slam/start_hypotheses.hpp"

namespace chainslam {

/// How a drive is localized in a map.
struct LocalizerOptions {
  /// Which scans are registered to the map; poses between them are odometry's.
  KeyframeOptions scans{.distance = 1.0, .angle = 0.2, .scan_voxel = 0.4, .scan_step = 0};
  StartOptions start{};                                       ///< when a recognized place is accepted
  OdometryNoise odometry_noise{};                             ///< of the poses between
  OdometryNoise unknown_odometry = unknown_odometry_noise();  ///< where frames state no covariance
  OdometryDoubt odometry_doubt{};                             ///< where scans between were lost or degenerate
  /// Largest squared Mahalanobis distance between a registered pose and the predicted one: the 99.99 % quantile of
  /// chi-squared with 6 degrees of freedom. What is farther off counts if the next scan agrees with it.
  double gate = 27.9;
  double max_distance = 30.0;    ///< metres along the path without a registration: beyond, the pose is uncertain,
  double max_deviation = 0.5;    ///< as it is beyond this standard deviation of the position, metres, any direction
  double lost_distance = 500.0;  ///< metres along the path without a registration: beyond, the pose is lost,
  double lost_deviation = 5.0;   ///< as it is beyond this standard deviation, metres
};

/// Places as they are sought from a cold start: by the little of the path that was travelled since.
[[nodiscard]] inline PlaceCandidateOptions localizer_places() {
  PlaceCandidateOptions options;
  options.submap_length = 15.0;
  options.spacing = 5.0;
  options.min_share = 0.0;
  options.max_count = 4;
  options.max_drawn = 0;
  options.index.min_inliers = 4;
  return options;
}

}  // namespace chainslam
