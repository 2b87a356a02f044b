#pragma once

#include <Eigen/Core>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/odometry/detail/imu_monitor.hpp"
#include "chainslam/odometry/detail/imu_record.hpp"
#include "chainslam/odometry/detail/mounting.hpp"
#include "chainslam/odometry/imu_process.hpp"

namespace chainslam::detail {

/// What was measured on the way from one state to another, against the way that the scans show. Interval 0 if not all
/// of it was measured. @param gravity  m/s^2
[[nodiscard]] inline ImuComparison compare_imu(const ImuRecord& imu, Timestamp begin, const InertialState& from,
                                               Timestamp end, const InertialState& to, double gravity) {
  const double interval = to_seconds(end - begin);
  // By one mounting at both ends: what has been learnt of it on the way is no turn of the body.
  const SO3d R_begin = remounted(from, T_body_lidar(to)).get<Inertial::rotation>();
  const Eigen::Vector3d turn = R_begin.local(to.get<Inertial::rotation>());
  Eigen::Vector3d gain = zeros<Eigen::Vector3d>(), way = zeros<Eigen::Vector3d>();  // by the specific force
  SO3d measured_turn;
  double at = 0;
  bool force_measured = true;
  bool measured = interval > 0;
  imu.for_each_step(begin, end, [&](const ImuStep& piece) {
    const double dt = piece.duration;
    at += dt;
    if (!piece.reading || !piece.reading->rate_measured) {
      measured = false;
      return;
    }
    force_measured = force_measured && piece.reading->force_measured;
    const double middle = (at - 0.5 * dt) / interval;
    const SO3d R = R_begin * SO3d::exp(scaled(middle, turn));
    const Eigen::Vector3d rate = difference_of(piece.reading->gyro, from.get<Inertial::gyro_bias>().value());
    const Eigen::Vector3d specific = difference_of(piece.reading->accel, from.get<Inertial::accel_bias>().value());
    measured_turn = measured_turn * SO3d::exp(scaled(dt, rate));
    const Eigen::Vector3d more = scaled(dt, R * specific);
    way = sum_of(way, scaled(dt, sum_of(gain, scaled(0.5, more))));
    gain = sum_of(gain, more);
  });
  if (!measured) return {};
  const Eigen::Vector3d gained =
      difference_of(to.get<Inertial::velocity>().value(), from.get<Inertial::velocity>().value());
  const Eigen::Vector3d force = divided(gain, interval);
  const Eigen::Vector3d error = difference_of(measured_turn.log(), turn);
  return {.interval = interval,
          .force_measured = force_measured,
          .rate = turn.norm() / interval,
          .rate_error = divided(error, interval),
          .force = force,
          .force_way = way,
          .up = difference_of(force, divided(gained, interval)),
          .expected_up = scaled(gravity, to.get<Inertial::up>().direction())};
}

}  // namespace chainslam::detail
