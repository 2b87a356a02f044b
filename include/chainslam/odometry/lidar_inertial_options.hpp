#pragma once

#include <limits>

#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/odometry/deskew.hpp"
#include "chainslam/odometry/detail/imu_monitor.hpp"
#include "chainslam/odometry/detail/inertial_motion.hpp"
#include "chainslam/odometry/detail/scan_measurement.hpp"
#include "chainslam/odometry/ieskf.hpp"
#include "chainslam/odometry/imu_process.hpp"
#include "chainslam/odometry/scan_to_map.hpp"
#include "chainslam/search/downsampling.hpp"
#include "chainslam/search/voxel_map.hpp"
#include "chainslam/sensor/imu_check.hpp"

namespace chainslam {

/// The parts of an inertial filter that decide whether it is FAST-LIO2's.
struct FastLio2Rules {
  ImuProcess process;              ///< propagation
  ScanToMap<Trivial> scan_to_map;  ///< registration
  ScanMeasurementOptions scan;     ///< linearization
  IterationRule iteration;         ///< convergence
  double variance;                 ///< of a residual, m^2
};

/// FAST-LIO2 (Xu et al. 2022, arXiv 2107.06829) with its published code's numbers where the paper gives none: Euler
/// steps, planes by a . p = -1, every residual within the gate counts alike, neighbours are looked up again once the
/// iteration has come to rest, at most five passes; no direction is ever held.
[[nodiscard]] inline FastLio2Rules fast_lio2() {
  constexpr double never = std::numeric_limits<double>::infinity();
  return {.process = {.noise = {.gyro = 2e-3, .accel_bias_walk = 5e-4}, .integration = ImuIntegration::euler},
          .scan_to_map = {.max_matchings = 5, .min_matches = 1, .rematch_distance = never, .min_signal = -never},
          .scan = {.planes = PlaneForm::intercept, .fresh_distance = 0, .coarse_to_fine = false, .mean_time = false},
          .iteration = {.max_iterations = 5, .step_tolerance = 1e-3},
          .variance = 1e-3};
}

/// Settings of `LidarInertialOdometry`; the defaults serve spinning LiDARs of 16 to 128 rings with any IMU
/// from 10 Hz to 1 kHz.
///
/// @tparam Downsampling  how the local map downsamples its input, such as `NearestToCenter`.
template <class Kernel = GemanMcClure, class Downsampling = VoxelMapOptions>
struct LidarInertialOdometryOptions {
  SE3d T_body_lidar{};                                          ///< extrinsic calibration; body = the IMU
  ScanFilter filter{};                                          ///< which points of a scan are used
  double map_voxel = 0.5;                                       ///< metres; points of a scan offered to the map
  double scan_voxel = 0.75;                                     ///< metres; points of a scan given to the filter
  Downsampling map = detail::half_metre_apart<Downsampling>();  ///< how the local map downsamples
  LocalMapOptions local_map{};                                  ///< what the local map keeps
  Index min_points = 50;            ///< after the voxel filter; scans with fewer count as empty
  double min_match_ratio = 0.2;     ///< of the points given to the filter; with less the scan is lost
  double poor_match_ratio = 0.8;    ///< of the usual one; with less other guesses are tried, the most matches decide
  double min_error = 0.3;           ///< metres a prediction may be off, whatever the filter thinks
  double max_error = 2.0;           ///< the same at most
  double max_correction = 8.0;      ///< metres off the prediction at which a pose is rejected
  double redeskew_distance = 0.06;  ///< metres of skew left after the update that call for a second pass
  Index max_lost_scans = 10;        ///< in a row; then the local map is reset at the estimated position
  ImuCheckOptions imu_check{};      ///< which IMU samples are rejected
  ImuUse imu_use = ImuUse::all;     ///< at most: all, the gyroscope, or none of the IMU's measurements
  ImuMonitorOptions monitor{};      ///< which IMU measurements are used
  InertialMotionOptions motion{};   ///< of the filter's process and start
  ScanClockOptions scan_clock{};    ///< how far the times of scans may be off
  /// A weaker signal counts than by itself: the prediction is weighed against it. Correlation set on KITTI 00.
  ScanToMap<Kernel> scan_to_map{.min_signal = 1.5, .correlated_residuals = 10};
  ScanMeasurementOptions scan{};  ///< how matches are weighed
  /// More than `scan_to_map.max_coarse_iterations`, so that some are left for the fine ones. A good prediction takes 3
  /// to 5 in all, a bad one dozens.
  IterationRule iteration{.max_iterations = 120, .step_tolerance = 1e-3};
  double residual_variance = 0;        ///< m^2; 0: learnt from the residuals
  double max_mounting_position = 0.3;  ///< metres off the given one; farther, the estimate is discarded
  double max_mounting_rotation = 0.1;  ///< radians
  double stated_deviations = 1.0;      ///< times the filter's: what frames state of their poses
};

/// FAST-LIO2 as published, with its map: settings of `LidarInertialOdometry<IkdTree<float, NearestToCenter>, Trivial>`.
[[nodiscard]] inline LidarInertialOdometryOptions<Trivial, NearestToCenter> fast_lio2_options() {
  const FastLio2Rules rules = fast_lio2();
  LidarInertialOdometryOptions<Trivial, NearestToCenter> options;
  options.map = {.voxel_size = 0.5};
  options.scan_voxel = 0.5;
  options.local_map.radius = 500;
  options.poor_match_ratio = 0;
  options.monitor.max_pose_nis = std::numeric_limits<double>::infinity();
  options.redeskew_distance = std::numeric_limits<double>::infinity();
  options.motion.process = rules.process;
  options.motion.lidar_rotation = 0;
  options.motion.start_speed = 5;
  options.motion.start_curvature = 0;
  options.motion.rest_share = 1;
  options.motion.accel_noise.start = 0;
  options.scan_clock.largest = 0;
  options.motion.imu.unseen_share = 0;
  options.motion.imu.max_step = std::numeric_limits<double>::infinity();
  options.scan_to_map = rules.scan_to_map;
  options.scan = rules.scan;
  options.iteration = rules.iteration;
  options.residual_variance = rules.variance;
  // It takes thousands of residuals that err alike for as many measurements: on KITTI 00's raw sweeps it states a 20th
  // of its errors, on simulated drives a 5th to a 50th.
  options.stated_deviations = 10;
  return options;
}

/// What the filter says of the last frame, beside its health.
struct InertialHealth {
  FilterStatus update = FilterStatus::no_information;  ///< how the last update ended
  double nis = 0;  ///< normalized innovation squared per residual, correlation taken off: about 1 if noise is what it
                   ///< is said to be
  Index degenerate_directions = 0;      ///< of six, that the scan did not see and that were not updated
  Vector6d signal = zeros<Vector6d>();  ///< ascending: information of these directions over that of pure noise
  double measured_share = 0;            ///< of the way to this frame, by the IMU
  double pose_nis = 0;  ///< normalized innovation squared of the pose, per direction that the scan sees: about 1
  ImuUse imu_use = ImuUse::all;  ///< what of the IMU's measurements the frame uses
  double accel_noise = 0;     ///< m/s^2 per sqrt(Hz): density of the accelerometer's, as the next prediction takes it
  double time_error = 0;      ///< seconds that the scan was taken later than stated
  double time_deviation = 0;  ///< seconds: of the times of scans, as the next update takes it
};

}  // namespace chainslam
