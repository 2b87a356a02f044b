#pragma once

#include <Eigen/Core>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/lie/so3.hpp"
#include "chainslam/odometry/imu_alignment.hpp"
#include "chainslam/odometry/imu_process.hpp"

namespace chainslam::detail {

/// The state with another T_body_lidar. The LiDAR stays where it is: its pose is what the map shows.
[[nodiscard]] inline InertialState remounted(InertialState x, const SE3d& mounting) {
  const SE3d T_odom = T_odom_body(x) * T_body_lidar(x) * mounting.inverse();
  x.get<Inertial::position>() = R3d(T_odom.translation());
  x.get<Inertial::rotation>() = T_odom.rotation();
  x.get<Inertial::lidar_position>() = R3d(mounting.translation());
  x.get<Inertial::lidar_rotation>() = mounting.rotation();
  return x;
}

/// Adds errors of T_body_lidar of these deviations (metres, radians) about each axis to a covariance.
///
/// The map is the LiDAR's: its pose is what is known there. Where that puts the body, and gravity, which the body
/// feels, is known as well as the mounting.
inline void doubt_mounting(InertialState::Jacobian& covariance, const InertialState& x, double position,
                           double rotation) {
  constexpr int up = inertial_offset<Inertial::up>, mounting = InertialState::dof - 6;
  // The LiDAR's pose stays: with J_b and J_m its derivatives by body and mounting, the body moves by -J_b^-1 J_m. Of
  // J_b = Ad diag(R^T, I) the inverse is diag(R, I) Ad^-1.
  const Matrix6d to_body = T_body_lidar(x).adjoint();
  Matrix6d body = negative(product(to_body, pose_tangent(x.get<Inertial::lidar_rotation>())));
  const Eigen::Matrix3d R = x.get<Inertial::rotation>().matrix();
  set_block(body, 0, 0, product(R, block_of<3, 6>(body, 0, 0)));
  const Eigen::Matrix3d by_turn = product(SO3d::hat(x.get<Inertial::up>().direction()), R);
  const Eigen::Matrix<double, 2, 3> up_by_turn = negative(transposed_product(x.get<Inertial::up>().basis(), by_turn));
  auto spread = zeros<Eigen::Matrix<double, InertialState::dof, 6>>();
  set_block(spread, 0, 0, body);
  set_block(spread, up, 0, product(up_by_turn, block_of<3, 6>(body, 3, 0)));
  for (int i = 0; i < 6; ++i) spread(mounting + i, i) = 1;
  for (int j = 0; j < 6; ++j)
    for (int i = 0; i < InertialState::dof; ++i) spread(i, j) *= j < 3 ? position : rotation;
  covariance = sum_of(covariance, product_transposed(spread, spread));
}

/// What a covariance says of the mounting's rotation beside a prior of this deviation (rad) about each axis, which was
/// that of `given`; nothing while it is held.
[[nodiscard]] inline RotationEvidence mounting_evidence(const InertialState& x,
                                                        const InertialState::Jacobian& covariance, const SO3d& given,
                                                        double prior_deviation) {
  constexpr int first = inertial_offset<Inertial::lidar_rotation>;
  RotationEvidence evidence{.about = given};
  const Eigen::Matrix3d posterior = block_of<3, 3>(covariance, first, first);
  if (!(posterior(0, 0) > 0)) return evidence;
  const Eigen::Matrix3d information = RotationEvidence::inverse_of(posterior);
  evidence.information = information;
  for (int i = 0; i < 3; ++i) evidence.information(i, i) -= 1 / (prior_deviation * prior_deviation);
  evidence.vector = product(information, given.local(x.get<Inertial::lidar_rotation>()));
  return evidence;
}

}  // namespace chainslam::detail
