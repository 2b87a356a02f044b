#pragma once

#include <doctest/doctest.h>

#include <Eigen/Core>

#include "simulator/vehicle_motion.hpp"

namespace chainslam::test {

/// Checks that velocity, acceleration and rates are the derivatives of the pose, up to `end` seconds.
/// @param motion_at  seconds to `Motion`.
template <class MotionAt>
void check_derivatives(double end, MotionAt&& motion_at) {
  constexpr double h = 1e-4;
  for (double t = 0.05; t < end; t += 0.173) {
    const simulator::Motion before = motion_at(t - h), now = motion_at(t), after = motion_at(t + h);
    const Eigen::Vector3d velocity = (after.T_map_body.translation() - before.T_map_body.translation()) / (2.0 * h);
    const Eigen::Vector3d acceleration = (after.velocity_map - before.velocity_map) / (2.0 * h);
    const Eigen::Vector3d rate =
        (before.T_map_body.rotation().inverse() * after.T_map_body.rotation()).log() / (2.0 * h);
    // Central differences: the third derivative times h^2 / 6, and rounding by h.
    CHECK((velocity - now.velocity_map).norm() < 1e-5);
    CHECK((acceleration - now.acceleration_map).norm() < 1e-4);
    CHECK((rate - now.rate_body).norm() < 1e-5);
  }
}

}  // namespace chainslam::test
