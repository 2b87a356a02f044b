#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/slam/closure_candidates.hpp"
#include "chainslam/slam/detail/start_hypotheses.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::detail {

/// Where an accepted closure puts its scan.
/// @param keyframes  of the map; ids are positions.
[[nodiscard]] [[gnu::cold]] inline UncertainPose placed(std::span<const Keyframe> keyframes,
                                                        const LoopClosure& closure) {
  const Keyframe& from = keyframes[static_cast<std::size_t>(closure.from.value)];
  return {from.T_map_body * closure.T_from_to, covariance_of(closure.sqrt_information)};
}

/// Whether a scan was registered, well or badly: in traffic, or where it sees more than the map has, it fits no better
/// at the right place than at a wrong one, unless only what both have is compared.
[[nodiscard]] inline bool is_registered(const LoopClosure& closure) {
  return closure.verdict == ClosureVerdict::accepted || closure.verdict == ClosureVerdict::high_residual;
}

/// The direction of the path at one of a drive's scans, in its body frame; ahead if it is the only one.
/// @param least  metres to the scan before or after it, for that to have a direction.
[[nodiscard]] [[gnu::cold]] inline Eigen::Vector3d direction_of_path(std::span<const Keyframe> keyframes,
                                                                     KeyframeId scan, double least) {
  const auto at = [&](Index i) -> const Keyframe& { return keyframes[static_cast<std::size_t>(i)]; };
  for (const Index other : {scan.value - 1, scan.value + 1}) {
    if (other < 0 || other >= to_index(keyframes.size()) || at(other).session != at(scan.value).session) continue;
    const Eigen::Vector3d way = (at(scan.value).T_odom_body.inverse() * at(other).T_odom_body).translation();
    if (const double length = way.norm(); length > least) return scaled(1 / length, way);
  }
  return {1, 0, 0};
}

/// Whether a scan comes back to where it was registered from `StartOptions::shift` to either side along the path.
///
/// In a street that is the same for a long way, or at a wrong place, it stays about where it starts or ends somewhere
/// else. Where it is right it comes back, whatever hides the map or is new.
template <class Closer, Executor E>
[[nodiscard]] [[gnu::cold]] bool comes_back(Closer& closer, std::span<const Keyframe> keyframes,
                                            const LoopClosure& closure, const StartHypotheses& hypotheses,
                                            const E& executor) {
  constexpr double least = 0.2;  // metres
  const Eigen::Vector3d ahead = scaled(hypotheses.options().shift, direction_of_path(keyframes, closure.to, least));
  for (const double side : {1.0, -1.0}) {
    const SE3d guess = closure.T_from_to * SE3d(SO3d(), scaled(side, ahead));
    const LoopClosure again = closer.align(keyframes, closure.from, closure.to, guess, executor);
    if (!is_registered(again) || !hypotheses.agree(closure.T_from_to, again.T_from_to)) return false;
  }
  return true;
}

/// Where a closure puts a scan, if it fits nowhere else there: nothing if it was not registered, if neither all nor
/// most of it fits, if its pose is known less well in some direction, or if it does not come back to it.
/// @param max_deviation  metres, the largest standard deviation of the position in any direction.
template <class Closer, Executor E>
[[nodiscard]] [[gnu::cold]] std::optional<UncertainPose> start_pose(Closer& closer, std::span<const Keyframe> keyframes,
                                                                    const LoopClosure& closure,
                                                                    const StartHypotheses& hypotheses,
                                                                    double max_deviation, const E& executor) {
  const bool repeats = hypotheses.options().shift > 0, fits = closure.verdict == ClosureVerdict::accepted;
  if (!is_registered(closure) || !(fits || repeats)) return std::nullopt;
  UncertainPose at{keyframes[static_cast<std::size_t>(closure.from.value)].T_map_body * closure.T_from_to,
                   hypotheses.agreement_covariance()};
  if (fits) at = placed(keyframes, closure);
  if (AlignmentStarts::deviation(at.covariance) > max_deviation) return std::nullopt;
  if (!fits && !closer.fits_in_part(keyframes, closure)) return std::nullopt;
  if (repeats && !comes_back(closer, keyframes, closure, hypotheses, executor)) return std::nullopt;
  return at;
}

}  // namespace chainslam::detail
