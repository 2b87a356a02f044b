#pragma once

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam::experiments {

/// An alignment that a run of the mapper made, and what the truth says of it.
struct Attempt {
  double distance = 0;     ///< true one between the two keyframes, metres
  bool converged = false;  ///< to something that passed for a closure, before it was compared with graph and chain
  Vector6d error = Vector6d::Zero();  ///< log(T_true^-1 T_measured), tangent [translation; rotation]
  SqrtInformation<6> sqrt_information = SqrtInformation<6>::Zero();  ///< that of the closure by itself
  double mean_squared_error = 0;
};

/// An accepted closure that is farther off counts as false: far beyond the noise of right ones, near enough for maps
/// to be damaged by it.
inline bool is_false(const Vector6d& error) { return error.head<3>().norm() > 1.0 || error.tail<3>().norm() > 0.1; }

/// What a run tried, by kind.
struct Attempts {
  std::vector<Attempt> closures;  ///< direct and chained, in the order of their distances
  std::vector<Attempt> merges;
};

namespace detail {

/// Whether an alignment was good by itself; graph, chain or a second place may have contradicted it later.
inline bool passed(ClosureVerdict verdict) {
  return verdict == ClosureVerdict::accepted || verdict == ClosureVerdict::implausible ||
         verdict == ClosureVerdict::inconsistent || verdict == ClosureVerdict::unconfirmed;
}

/// Closures of one scan share their information; this takes that back. @returns its share by position.
inline std::vector<double> shares(const SlamMap& map, double correlation) {
  std::vector<double> others(map.closures.size(), 0.0);
  for (const LoopClosure& closure : map.closures)
    if (closure.kind == ClosureKind::chained && closure.cause >= 0) ++others[static_cast<std::size_t>(closure.cause)];
  std::vector<double> shares;
  for (std::size_t i = 0; i < map.closures.size(); ++i) {
    const LoopClosure& closure = map.closures[i];
    const auto cause =
        closure.kind == ClosureKind::chained && closure.cause >= 0 ? static_cast<std::size_t>(closure.cause) : i;
    shares.push_back(1 / std::sqrt(1 + others[cause] * correlation));
  }
  return shares;
}

}  // namespace detail

/// What the map's run tried, wherever the truth is known.
/// @param truths  T_truth_body of each session, all in one frame.
/// @param correlation  `ChainOptions::correlation` of the run.
inline Attempts attempts_of(const SlamMap& map, const std::vector<Trajectory>& truths, double correlation) {
  const auto true_pose = [&](KeyframeId id) {
    const Keyframe& keyframe = map.keyframes[static_cast<std::size_t>(id.value)];
    return pose_at(truths[static_cast<std::size_t>(keyframe.session.value)], keyframe.time, seconds(2.0));
  };
  Attempts attempts;
  const auto add = [&](const LoopClosure& closure, double share) {
    const auto j = true_pose(closure.from), i = true_pose(closure.to);
    if (!j || !i) return;
    const SE3d T_true = j->inverse() * *i;
    Attempt attempt{.distance = T_true.translation().norm(),
                    .converged = detail::passed(closure.verdict),
                    .error = (T_true.inverse() * closure.T_from_to).log(),
                    .sqrt_information = closure.sqrt_information,
                    .mean_squared_error = closure.mean_squared_error};
    for (int k = 0; k < 36; ++k) attempt.sqrt_information.data()[k] /= share;
    (closure.kind == ClosureKind::merge ? attempts.merges : attempts.closures).push_back(attempt);
  };
  const std::vector<double> shares = detail::shares(map, correlation);
  for (std::size_t i = 0; i < map.closures.size(); ++i) add(map.closures[i], shares[i]);
  for (const LoopClosure& refusal : map.refusals) add(refusal, 1.0);
  std::ranges::stable_sort(attempts.closures, {}, &Attempt::distance);
  return attempts;
}

/// Draws one of the attempts whose true distance is most like this one. @pre attempts are in the order of distances.
inline const Attempt& drawn(const std::vector<Attempt>& attempts, double distance, Rng& rng) {
  constexpr std::ptrdiff_t alike = 20;
  const auto at = std::ranges::lower_bound(attempts, distance, {}, &Attempt::distance) - attempts.begin();
  const std::ptrdiff_t size = std::ssize(attempts), count = std::min(alike, size);
  const std::ptrdiff_t first = std::clamp<std::ptrdiff_t>(at - count / 2, 0, size - count);
  return attempts[static_cast<std::size_t>(first + rng.uniform_index(static_cast<Index>(count)))];
}

/// The information of one that was accepted, for one that was refused later and so has none.
inline const SqrtInformation<6>& information_of(const Attempt& attempt, const std::vector<Attempt>& attempts,
                                                Rng& rng) {
  if (!attempt.sqrt_information.isZero(0)) return attempt.sqrt_information;
  const auto count = static_cast<Index>(attempts.size());
  const Index start = rng.uniform_index(count);
  for (Index k = 0; k < count; ++k)
    if (const Attempt& other = attempts[static_cast<std::size_t>((start + k) % count)];
        !other.sqrt_information.isZero(0))
      return other.sqrt_information;
  return attempt.sqrt_information;
}

}  // namespace chainslam::experiments
