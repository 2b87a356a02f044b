#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <optional>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/sensor/packet.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam::experiments {

/// A frame of odometry, keyframe or not.
struct MeasuredFrame {
  Timestamp time;
  SE3d T_truth_body;
  std::optional<Eigen::Vector3f> delta_velocity{};  ///< see `Frame::delta_velocity`
};

/// What a recording has up to a keyframe, since the one before.
struct Leg {
  std::vector<MeasuredFrame> frames{};  ///< the keyframe's own is the last
  std::vector<GnssFix> fixes{};         ///< that came before the keyframe
};

/// One session.
struct MeasuredDrive {
  Trajectory truth;                   ///< T_truth_body of its keyframes
  Trajectory odometry;                ///< T_odom_body at the same times
  std::vector<Leg> legs{};            ///< of each keyframe
  std::vector<GnssFix> last_fixes{};  ///< that came after the last keyframe

  /// log(T_true^-1 T_measured) of each step from keyframe to keyframe, tangent [translation; rotation].
  [[nodiscard]] std::vector<Vector6d> step_errors() const {
    std::vector<Vector6d> errors;
    for (std::size_t i = 1; i < truth.size(); ++i) {
      const SE3d T_true = truth.poses[i - 1].inverse() * truth.poses[i];
      const SE3d T_measured = odometry.poses[i - 1].inverse() * odometry.poses[i];
      errors.push_back((T_true.inverse() * T_measured).log());
    }
    return errors;
  }
};

/// Keyframes over which errors stay together when they are drawn: what is correlated over shorter ways stays so.
inline constexpr Index block_length = 25;

/// Errors of steps in two parts: those of a pose that the next step takes back, and the drift that stays. Cut blocks
/// would make a random walk of the first.
struct SplitErrors {
  std::vector<Vector6d> drift;   ///< of each step
  std::vector<Vector6d> jitter;  ///< of each pose, one more
};

/// Jitter is how far the sum of the errors lies from its mean over the nearest poses.
inline SplitErrors split(const std::vector<Vector6d>& steps) {
  constexpr std::ptrdiff_t reach = 5;  // poses on each side
  std::vector<Vector6d> sums{Vector6d(Vector6d::Zero())};
  for (const Vector6d& step : steps) sums.push_back(sums.back() + step);
  SplitErrors errors;
  for (std::ptrdiff_t i = 0; i < std::ssize(sums); ++i) {
    const std::ptrdiff_t side = std::min({reach, i, std::ssize(sums) - 1 - i});
    Vector6d mean = Vector6d::Zero();
    for (std::ptrdiff_t k = i - side; k <= i + side; ++k) mean += sums[static_cast<std::size_t>(k)];
    errors.jitter.emplace_back(sums[static_cast<std::size_t>(i)] - mean / static_cast<double>(2 * side + 1));
  }
  for (std::size_t i = 0; i < steps.size(); ++i)
    errors.drift.emplace_back(steps[i] - (errors.jitter[i + 1] - errors.jitter[i]));
  return errors;
}

/// Errors of as many steps, drawn in blocks from those of one session, which begin anywhere and go on at its start
/// (circular block bootstrap, Politis and Romano 1992): their mean, spread and correlation are that session's.
inline std::vector<Vector6d> drawn_errors(const std::vector<Vector6d>& measured, std::size_t steps, Rng& rng) {
  std::vector<Vector6d> errors;
  if (measured.empty()) return std::vector<Vector6d>(steps, Vector6d(Vector6d::Zero()));
  const SplitErrors parts = split(measured);
  Vector6d before = Vector6d::Zero();  // jitter of the pose that the next step begins at
  while (errors.size() < steps) {
    const auto start = static_cast<std::size_t>(rng.uniform_index(static_cast<Index>(measured.size())));
    if (errors.empty()) before = parts.jitter[start];
    for (Index k = 0; k < block_length && errors.size() < steps; ++k) {
      const std::size_t i = (start + static_cast<std::size_t>(k)) % measured.size();
      errors.emplace_back(parts.drift[i] + parts.jitter[i + 1] - before);
      before = parts.jitter[i + 1];
    }
  }
  return errors;
}

/// Odometry at the keyframes of a drive.
struct DrawnOdometry {
  Trajectory odometry;           ///< T_odom_body
  std::vector<Vector6d> errors;  ///< of its steps
};

/// The drive along the true path with odometry that errs as a session of `errors`, drawn at random, did.
/// @param errors  of each session, as `step_errors` has them.
inline DrawnOdometry drawn_odometry(const Trajectory& truth, const std::vector<std::vector<Vector6d>>& errors,
                                    Rng rng) {
  const auto& measured = errors[static_cast<std::size_t>(rng.uniform_index(static_cast<Index>(errors.size())))];
  DrawnOdometry drawn{.odometry = {.times = truth.times, .poses = {SE3d()}},
                      .errors = drawn_errors(measured, truth.size() - 1, rng)};
  std::vector<SE3d>& poses = drawn.odometry.poses;
  for (std::size_t i = 1; i < truth.size(); ++i)
    poses.push_back(poses.back() * (truth.poses[i - 1].inverse() * truth.poses[i]) * SE3d::exp(drawn.errors[i - 1]));
  return drawn;
}

}  // namespace chainslam::experiments
