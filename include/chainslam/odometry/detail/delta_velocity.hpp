#pragma once

#include <Eigen/Core>
#include <optional>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/lie/so3.hpp"
#include "chainslam/odometry/detail/imu_record.hpp"

namespace chainslam::detail {

/// What an accelerometer measured from `begin` to `end`: its specific force, integrated in the body frame at `end`,
/// m/s. Gravity and bias are in it. Nothing if not all of it was measured.
/// @param turn  of the body on the way, tangent at its begin, radians; it is taken to be even.
[[nodiscard]] inline std::optional<Eigen::Vector3d> delta_velocity(const ImuRecord& imu, Timestamp begin, Timestamp end,
                                                                   const Eigen::Vector3d& turn) {
  const double interval = to_seconds(end - begin);
  if (!(interval > 0)) return std::nullopt;
  Eigen::Vector3d sum = zeros<Eigen::Vector3d>();
  double at = 0;
  bool measured = true;
  imu.for_each_step(begin, end, [&](const ImuStep& piece) {
    at += piece.duration;
    measured = measured && piece.reading && piece.reading->force_measured;
    if (!measured) return;
    const double left = (interval - at + 0.5 * piece.duration) / interval;
    const SO3d R_end_now = SO3d::exp(scaled(-left, turn));
    sum = sum_of(sum, scaled(piece.duration, R_end_now * piece.reading->accel));
  });
  if (!measured) return std::nullopt;
  return sum;
}

}  // namespace chainslam::detail
