#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <numbers>

#include "chainslam/lie/se3.hpp"

namespace chainslam::simulator {

// Where the sensors sit, nominally: NCLT's published calibration (the robot's `base`, x ahead, y right, z down).
// The library's frames have z up: `body` is the inertial unit and `lidar` the Velodyne, each turned by pi about its x
// axis.

/// Changes a frame's axes between (x, y, z down) and (x, -y, z up); its own inverse.
[[nodiscard]] inline SE3d flip_axes() {
  return SE3d(SO3d::from_quaternion(Eigen::Quaterniond(0.0, 1.0, 0.0, 0.0)), Eigen::Vector3d::Zero());
}

/// R = Rz(yaw) Ry(pitch) Rx(roll), radians.
[[nodiscard]] inline SO3d from_roll_pitch_yaw(double roll, double pitch, double yaw) {
  return SO3d::exp(yaw * Eigen::Vector3d::UnitZ()) * SO3d::exp(pitch * Eigen::Vector3d::UnitY()) *
         SO3d::exp(roll * Eigen::Vector3d::UnitX());
}

/// The HDL-32E on the robot.
[[nodiscard]] inline SE3d nominal_T_base_velodyne() {
  constexpr double degree = std::numbers::pi / 180.0;
  return SE3d(from_roll_pitch_yaw(0.807 * degree, 0.166 * degree, -90.703 * degree),
              Eigen::Vector3d(0.002, -0.004, -0.957));
}

/// The Microstrain MS25 inertial unit on the robot.
[[nodiscard]] inline SE3d nominal_T_base_ms25() { return SE3d(SO3d(), Eigen::Vector3d(-0.11, -0.18, -0.71)); }

/// The antenna of the consumer GNSS receiver in `base`, metres.
[[nodiscard]] inline Eigen::Vector3d nominal_antenna_base() { return {0.0, 0.25, -0.51}; }

/// What an estimator should take for the pose of the LiDAR in the body frame (z up).
[[nodiscard]] inline SE3d nominal_T_body_lidar() {
  return flip_axes() * nominal_T_base_ms25().inverse() * nominal_T_base_velodyne() * flip_axes();
}

/// The antenna's place in the body frame (z up), metres.
[[nodiscard]] inline Eigen::Vector3d nominal_antenna_body() {
  return flip_axes() * (nominal_T_base_ms25().inverse() * nominal_antenna_base());
}

// A car in the manner of MARS: `ego` stands on the road below the rear axle, x ahead, y left, z up. The LiDAR's
// mounting is the one of its example; `imu` is the body frame.

[[nodiscard]] inline SE3d nominal_T_ego_lidar() {
  return SE3d(from_roll_pitch_yaw(0.0, 0.0, -1.9 * std::numbers::pi / 180.0), Eigen::Vector3d(2.128, 0.0, 1.57));
}

[[nodiscard]] inline SE3d nominal_T_ego_imu() { return SE3d(SO3d(), Eigen::Vector3d(1.0, 0.0, 1.9)); }

/// Metres.
[[nodiscard]] inline Eigen::Vector3d nominal_antenna_ego() { return {0.2, 0.3, 1.95}; }

// KITTI's car: the HDL-64E, the OXTS RT3003 (x ahead, y left, z up) and the left grey camera (x right, y down, z
// ahead).

/// calib_imu_to_velo.txt of 2011_09_26; that of the other days is near.
[[nodiscard]] inline SE3d kitti_T_lidar_imu() {
  Eigen::Matrix3d R;
  R << 9.999976e-01, 7.553071e-04, -2.035826e-03, -7.854027e-04, 9.998898e-01, -1.482298e-02, 2.024406e-03,
      1.482454e-02, 9.998881e-01;
  return SE3d(SO3d::from_matrix(R), {-8.086759e-01, 3.195559e-01, -7.997231e-01});
}

/// `Tr` of sequences 00 to 02 (2011_10_03).
[[nodiscard]] inline SE3d kitti_T_camera_lidar() {
  Eigen::Matrix3d R;
  R << 4.276802385584e-04, -9.999672484946e-01, -8.084491683471e-03, -7.210626507497e-03, 8.081198471645e-03,
      -9.999413164504e-01, 9.999738645903e-01, 4.859485810390e-04, -7.206933692422e-03;
  return SE3d(SO3d::from_matrix(R), {-1.198459927713e-02, -5.403984729748e-02, -2.921968648686e-01});
}

}  // namespace chainslam::simulator
