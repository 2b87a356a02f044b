#pragma once

#include <Eigen/Core>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/odometry/imu_process.hpp"

namespace chainslam::detail {

/// The body's motion from some time on, until the next.
struct WayKnot {
  Timestamp time;
  SE3d T_odom_body;
  Eigen::Vector3d velocity, acceleration;  ///< odom
  Eigen::Vector3d rate;                    ///< body

  [[nodiscard]] SE3d pose(double dt) const {
    const Eigen::Vector3d mean_velocity = sum_of(velocity, scaled(0.5 * dt, acceleration));
    return SE3d(T_odom_body.rotation() * SO3d::exp(scaled(dt, rate)),
                sum_of(T_odom_body.translation(), scaled(dt, mean_velocity)));
  }
};

/// The part of a correction of the pose at the end of a way that arose on that way; the rest had been there before. A
/// smoother's step back (Rauch, Tung, Striebel 1965), for the variances of position and of rotation as a whole.
/// @param before, after  covariance at the begin of the way, and predicted for its end. @param correction  tangent.
[[nodiscard]] inline Vector6d arisen(const InertialState::Jacobian& before, const InertialState::Jacobian& after,
                                     const Vector6d& correction) {
  const auto share = [&](int part) {
    double had = 0, has = 0;
    for (int i = part; i < part + 3; ++i) had += before(i, i), has += after(i, i);
    return has > had ? 1 - had / has : 0.0;
  };
  const double position = share(inertial_offset<Inertial::position>);
  const double rotation = share(inertial_offset<Inertial::rotation>);
  Vector6d part = zeros<Vector6d>();
  for (int i = 0; i < 3; ++i) part[i] = position * correction[i], part[3 + i] = rotation * correction[3 + i];
  return part;
}

}  // namespace chainslam::detail
