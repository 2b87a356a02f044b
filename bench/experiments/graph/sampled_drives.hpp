#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam::experiments {

/// One session at its keyframes.
struct MeasuredDrive {
  Trajectory truth;     ///< T_truth_body
  Trajectory odometry;  ///< T_odom_body at the same times

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

/// Errors of as many steps, drawn in blocks from those of one session, which begin anywhere and go on at its start
/// (circular block bootstrap, Politis and Romano 1992): their mean, spread and correlation are that session's.
inline std::vector<Vector6d> drawn_errors(const std::vector<Vector6d>& measured, std::size_t steps, Rng& rng) {
  std::vector<Vector6d> errors;
  if (measured.empty()) return std::vector<Vector6d>(steps, Vector6d(Vector6d::Zero()));
  while (errors.size() < steps) {
    const auto start = static_cast<std::size_t>(rng.uniform_index(static_cast<Index>(measured.size())));
    for (Index k = 0; k < block_length && errors.size() < steps; ++k)
      errors.push_back(measured[(start + static_cast<std::size_t>(k)) % measured.size()]);
  }
  return errors;
}

/// The drive along the true path with odometry that errs as a session of `errors`, drawn at random, did.
/// @param errors  of each session, as `step_errors` has them.
inline Trajectory drawn_odometry(const Trajectory& truth, const std::vector<std::vector<Vector6d>>& errors, Rng rng) {
  const auto& measured = errors[static_cast<std::size_t>(rng.uniform_index(static_cast<Index>(errors.size())))];
  const std::vector<Vector6d> drawn = drawn_errors(measured, truth.size() - 1, rng);
  Trajectory odometry{.times = truth.times, .poses = {SE3d()}};
  for (std::size_t i = 1; i < truth.size(); ++i)
    odometry.poses.push_back(odometry.poses.back() * (truth.poses[i - 1].inverse() * truth.poses[i]) *
                             SE3d::exp(drawn[i - 1]));
  return odometry;
}

}  // namespace chainslam::experiments
