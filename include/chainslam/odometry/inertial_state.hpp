#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/product.hpp"
#include "chainslam/lie/rn.hpp"
#include "chainslam/lie/s2.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/lie/so3.hpp"

namespace chainslam {

/// What LiDAR-inertial odometry estimates, 26 degrees of freedom (FAST-LIO2, eq. 3, with gravity's length known, and
/// how the map is out of level): `state.get<Inertial::velocity>()`.
struct Inertial {
  /// Positions of the parts of the state.
  enum Part : std::size_t {
    position,        ///< of the body in odom, metres
    rotation,        ///< R_odom_body
    velocity,        ///< of the body in odom, m/s
    gyro_bias,       ///< rad/s
    accel_bias,      ///< m/s^2
    up,              ///< against gravity, in odom
    creep,           ///< by how much `up` has moved since the start, along x and y
    bend,            ///< 1/m: `up` leans with the way by so much, as over a map bent like a bowl
    lidar_position,  ///< of the LiDAR in the body frame, metres
    lidar_rotation,  ///< R_body_lidar
  };
};
using InertialState = Product<R3d, SO3d, R3d, R3d, R3d, S2d, R2d, R1d, R3d, SO3d>;
static_assert(InertialState::dof == 26);

/// Where the tangent of a part starts.
template <Inertial::Part Part>
inline constexpr int inertial_offset = InertialState::offset<Part>();

[[nodiscard]] inline SE3d T_odom_body(const InertialState& x) {
  return SE3d(x.get<Inertial::rotation>(), x.get<Inertial::position>().value());
}
[[nodiscard]] inline SE3d T_body_lidar(const InertialState& x) {
  return SE3d(x.get<Inertial::lidar_rotation>(), x.get<Inertial::lidar_position>().value());
}

/// d T / d (position, rotation), with T's tangent as everywhere, [translation in its own axes; rotation].
[[nodiscard]] inline Matrix6d pose_tangent(const SO3d& R) {
  Matrix6d tangent = identity<Matrix6d>();
  set_block(tangent, 0, 0, R.inverse().matrix());
  return tangent;
}

/// d (T_odom_body * T_body_lidar) / d x, 6 x 26.
[[nodiscard]] inline Eigen::Matrix<double, 6, InertialState::dof> lidar_pose_jacobian(const InertialState& x) {
  auto jacobian = zeros<Eigen::Matrix<double, 6, InertialState::dof>>();
  const Matrix6d to_lidar = T_body_lidar(x).inverse().adjoint();
  set_block(jacobian, 0, 0, product(to_lidar, pose_tangent(x.get<Inertial::rotation>())));
  set_block(jacobian, 0, InertialState::dof - 6, pose_tangent(x.get<Inertial::lidar_rotation>()));
  return jacobian;
}

/// Variances of T_odom_body * T_body_lidar from the covariance of the state; tangent [translation; rotation].
[[nodiscard]] inline Vector6d lidar_pose_variances(const InertialState& x, const InertialState::Jacobian& covariance) {
  const Eigen::Matrix<double, 6, InertialState::dof> by_state = lidar_pose_jacobian(x);
  const Eigen::Matrix<double, 6, InertialState::dof> weighted = product(by_state, covariance);
  Vector6d variances = zeros<Vector6d>();
  for (int j = 0; j < InertialState::dof; ++j)
    for (int i = 0; i < 6; ++i) variances[i] += weighted(i, j) * by_state(i, j);
  return variances;
}

/// Covariance of T_odom_body from that of the state; tangent [translation; rotation].
[[nodiscard]] inline Matrix6d pose_covariance(const InertialState& x, const InertialState::Jacobian& covariance) {
  const Matrix6d tangent = pose_tangent(x.get<Inertial::rotation>());
  return product_transposed(product(tangent, block_of<6, 6>(covariance, 0, 0)), tangent);
}

/// Makes variances those of `deviation` at least, ...
inline void raise(InertialState::Jacobian& covariance, int begin, int end, double deviation) {
  for (int i = begin; i < end; ++i) covariance(i, i) = std::max(covariance(i, i), deviation * deviation);
}
/// ... those of a part.
template <Inertial::Part Part>
inline void raise(InertialState::Jacobian& covariance, double deviation) {
  constexpr int begin = inertial_offset<Part>;
  raise(covariance, begin, begin + InertialState::Part<Part>::dof, deviation);
}

/// Makes variances those of `deviation`, correlated with nothing, ...
inline void separate(InertialState::Jacobian& covariance, int begin, int end, double deviation) {
  for (int i = begin; i < end; ++i) {
    for (int j = 0; j < InertialState::dof; ++j) covariance(i, j) = covariance(j, i) = 0;
    covariance(i, i) = deviation * deviation;
  }
}
/// ... those of a part.
template <Inertial::Part Part>
inline void separate(InertialState::Jacobian& covariance, double deviation) {
  constexpr int begin = inertial_offset<Part>;
  separate(covariance, begin, begin + InertialState::Part<Part>::dof, deviation);
}

}  // namespace chainslam
