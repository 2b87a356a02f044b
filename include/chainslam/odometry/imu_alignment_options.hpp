#pragma once

#include <Eigen/Core>

#include "chainslam/lie/se3.hpp"
#include "chainslam/lie/so3.hpp"

namespace chainslam {

/// Settings of `ImuAlignment`.
struct ImuAlignmentOptions {
  double time_offset = 0;              ///< s, given or assumed: stamp of an IMU measurement less its true time
  double time_offset_deviation = 0.1;  ///< s
  double max_time_offset = 0.25;       ///< s, either way
  SE3d T_body_lidar;                   ///< given; where the IMU sits in the LiDAR's frame is taken as it is
  double rotation_deviation = 0.05;    ///< rad, of the given rotation about each axis; infinite if it is not known
  double gyro_bias_deviation = 0.05;   ///< rad/s
  double accel_bias_deviation = 0.3;   ///< m/s^2
  double half_span = 0.5;              ///< s between the positions whose second difference is an acceleration
  double max_step = 1.5;               ///< s; poses farther apart are not compared
  double max_gap = 0.1;                ///< s between IMU measurements that are joined
  double block = 10;                   ///< s over which gravity is constant in the LiDAR odometry's frame
  double window = 60;                  ///< s of measurements kept as such; what is older is kept as equations
  double memory = 300;                 ///< s of these
  double min_duration = 1;             ///< s of poses before the first estimate
  double growth = 0.25;                ///< of the data, between estimates, ...
  double interval = 1;                 ///< ... at most so many s, ...
  double known_interval = 5;           ///< ... once offset and rotation are known
  double search_interval = 10;         ///< s between searches of all offsets, once offset and rotation are known
  double time_offset_floor = 0.002;    ///< s of the deviation that more data do not reduce: of the scans' own times
  double rotation_floor = 0.002;       ///< rad, likewise: of the LiDAR's calibration
  double min_contrast = 50;  ///< squared deviations by which the best offset must beat others; before, no estimate
  double known_time_offset = 0.005;     ///< s, standard deviation from which the offset counts as known
  double known_rotation = 0.01;         ///< rad, likewise, about the worst axis
  double contradiction_sigmas = 5;      ///< by so many deviations, and by so large ...
  double contradiction_angle = 0.0524;  ///< ... an angle (rad) the given rotation must be off to be contradicted
};

/// What is known of how and when the IMU measures.
struct ImuAlignmentEstimate {
  /// s: an IMU measurement's time on the LiDAR's clock is its stamp less this; positive if the IMU's stamps are late.
  double time_offset = 0;
  double time_offset_deviation = 0;                                 ///< seconds, standard deviation
  SO3d R_body_lidar;                                                ///< rotation from the LiDAR's to the body's axes
  Eigen::Matrix3d rotation_covariance = Eigen::Matrix3d::Zero();    ///< right tangent (LiDAR axes), rad^2
  Eigen::Vector3d gyro_bias = Eigen::Vector3d::Zero();              ///< rad/s
  Eigen::Matrix3d gyro_bias_covariance = Eigen::Matrix3d::Zero();   ///< (rad/s)^2
  Eigen::Vector3d accel_bias = Eigen::Vector3d::Zero();             ///< m/s^2
  Eigen::Matrix3d accel_bias_covariance = Eigen::Matrix3d::Zero();  ///< (m/s^2)^2
  Eigen::Vector3d up_odom = Eigen::Vector3d::Zero();  ///< against gravity in the newest poses' frame; 0 if unknown
  bool time_known = false;                            ///< to `known_time_offset`
  bool rotation_known = false;                        ///< to `known_rotation` about all axes
  int observed_rotation_axes = 0;                     ///< of three principal axes: known to `known_rotation`
  bool contradicted = false;       ///< the data exclude the given rotation; the estimate then leaves it out
  double contradiction_angle = 0;  ///< rad: by so much, about the axis that shows it best
  double seconds_used = 0;         ///< of poses with IMU measurements
};

}  // namespace chainslam
