#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <optional>
#include <span>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/factors.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/sensor/frame.hpp"

namespace chainslam {

/// How gravity, as the accelerometer measures it, holds the map upright.
struct GravityFactorOptions {
  bool enabled = true;           ///< else gravity does not count
  double window = 10.0;          ///< seconds of measurements that give one direction
  double speed_deviation = 0.1;  ///< m/s that odometry's velocity may be off at each end of a window
  /// Radians that a direction may be off beyond that: the accelerometer's bias and how the IMU is mounted.
  double deviation = 0.01;
  double threshold = 30.0;  ///< squared whitened residual beyond which a direction is an outlier
  /// Radians that a frame of the map, which begins as odometry does, may lean: how well the start knew gravity.
  double start_deviation = 0.1;
};

/// The direction against gravity.
struct GravityMeasurement {
  Eigen::Vector3d up;  ///< unit vector
  double sigma;        ///< radians
};

namespace detail {

/// Velocity at a frame by those two before and two after it, m/s, odom frame.
[[nodiscard]] inline Eigen::Vector3d mean_velocity(std::span<const FrameRecord> frames, std::size_t at) {
  const FrameRecord &before = frames[at - 2], &after = frames[at + 2];
  return divided(difference_of(after.T_odom_body.translation(), before.T_odom_body.translation()),
                 to_seconds(after.time - before.time));
}

}  // namespace detail

/// The direction against gravity, seen from odometry's frame, by the specific force over a window less the acceleration
/// that odometry shows. How that frame lies does not matter, only how the body turned in the window: where odometry's
/// attitude drifts, the direction is best in the middle of the window.
/// @param frames  consecutive frames of one session.
/// @returns nothing if the force was not measured all the time, a scan was lost, or its mean is not about 9.8 m/s^2.
[[nodiscard]] [[gnu::cold]] inline std::optional<GravityMeasurement> measure_gravity(
    std::span<const FrameRecord> frames, const GravityFactorOptions& options) {
  constexpr std::size_t margin = 2;  // frames at each end that show the velocity
  constexpr double standard = 9.80665, tolerance = 0.5;
  if (frames.size() < 4 * margin) return std::nullopt;
  const std::size_t first = margin, last = frames.size() - 1 - margin;
  Eigen::Vector3d gained = zeros<Eigen::Vector3d>();  // by the specific force, odom frame
  for (std::size_t i = 1; i < frames.size(); ++i) {
    const FrameRecord& frame = frames[i];
    if (!frame.delta_velocity || frame.health.status == FrameStatus::lost || frame.health.map_restarted)
      return std::nullopt;
    if (i <= first || i > last) continue;
    gained = sum_of(gained, frame.T_odom_body.rotation() * converted<double>(*frame.delta_velocity));
  }
  const double duration = to_seconds(frames[last].time - frames[first].time);
  const Eigen::Vector3d moved =
      difference_of(detail::mean_velocity(frames, last), detail::mean_velocity(frames, first));
  const Eigen::Vector3d up = divided(difference_of(gained, moved), duration);
  const double length = up.norm();
  if (!(std::abs(length - standard) <= tolerance)) return std::nullopt;
  const double by_velocity = options.speed_deviation * std::sqrt(2.0) / (duration * standard);
  const double deviation = std::sqrt(options.deviation * options.deviation + by_velocity * by_velocity);
  return GravityMeasurement{divided(up, length), deviation};
}

/// What a direction against gravity says of a keyframe's attitude: a prior that leaves its position and heading open.
/// @param measured  in the body frame.
/// @param pose      by the estimate, in a map whose z axis points against gravity.
[[nodiscard]] [[gnu::cold]] inline PriorFactor<SE3d> gravity_prior(Key key, const GravityMeasurement& measured,
                                                                   const SE3d& pose) {
  const Eigen::Vector3d up = pose.rotation().inverse() * Eigen::Vector3d(Eigen::Vector3d::UnitZ());
  PriorFactor<SE3d> prior{key, pose * SE3d(SO3d::between(measured.up, up), zeros<Eigen::Vector3d>()),
                          zeros<SqrtInformation<6>>()};
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i)
      prior.sqrt_information(3 + i, 3 + j) =
          ((i == j ? 1.0 : 0.0) - measured.up.data()[i] * measured.up.data()[j]) / measured.sigma;
  return prior;
}

/// The prior of a frame's first keyframe, as tight as `anchor` but for its lean.
/// @param anchor  standard deviation, metres and radians.
/// @param lean    standard deviation of roll and pitch, radians.
[[nodiscard]] [[gnu::cold]] inline SqrtInformation<6> leaning_anchor(const SE3d& prior, double anchor, double lean) {
  const Eigen::Vector3d up = prior.rotation().inverse() * Eigen::Vector3d(Eigen::Vector3d::UnitZ());
  Matrix6d covariance = scaled(anchor * anchor, identity<Matrix6d>());
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i)
      covariance(3 + i, 3 + j) += lean * lean * ((i == j ? 1.0 : 0.0) - up.data()[i] * up.data()[j]);
  return NoiseModel<6>::from_covariance(covariance).sqrt_information();
}

}  // namespace chainslam
