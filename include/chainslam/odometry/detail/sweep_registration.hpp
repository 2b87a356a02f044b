#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <utility>

#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/odometry/deskew.hpp"
#include "chainslam/odometry/detail/first_sweep.hpp"
#include "chainslam/odometry/detail/imu_monitor.hpp"
#include "chainslam/odometry/detail/inertial_motion.hpp"
#include "chainslam/odometry/detail/moved_distance.hpp"
#include "chainslam/odometry/detail/scan_clock.hpp"
#include "chainslam/odometry/detail/scan_measurement.hpp"
#include "chainslam/odometry/detail/sweep.hpp"
#include "chainslam/odometry/detail/sweep_attempt.hpp"
#include "chainslam/odometry/detail/translation_search.hpp"
#include "chainslam/odometry/lidar_inertial_options.hpp"
#include "chainslam/odometry/scan_to_map.hpp"

namespace chainslam::detail {

/// How `LidarInertialOdometry` registers a sweep: attempts from one prediction after the other, and which of them is
/// taken. Its parts are the odometry's own.
template <class Map, class Kernel>
struct SweepRegistration {
  using Options = LidarInertialOdometryOptions<Kernel, typename LocalMap<Map>::Downsampling>;
  using Clouds = SweepClouds;
  using Guess = SweepGuess;
  using Attempt = SweepAttempt;
  using AttemptPtr = SweepAttemptPtr;

  explicit SweepRegistration(const Options& options)
      : options_(options),
        map_(options_.map, options_.local_map),
        motion_(options_.motion, options_.T_body_lidar),
        monitor_(options_.monitor),
        scan_clock_(options_.scan_clock) {}

  [[nodiscard]] const InertialState& state() const { return motion_.state(); }
  [[nodiscard]] const InertialState::Jacobian& covariance() const { return motion_.filter().covariance(); }

  template <Executor E>
  [[nodiscard]] Clouds straightened(const Sweep& sweep, const SweepMotion& motion, const E& executor) const;
  template <Executor E>
  [[nodiscard]] AttemptPtr attempt(const Sweep& sweep, const Guess& guess, const E& executor) const;
  template <Executor E>
  [[nodiscard]] AttemptPtr attempt(const Sweep& sweep, const E& executor) const;
  template <Executor E>
  [[nodiscard]] AttemptPtr consistent(const Sweep& sweep, const E& executor);
  template <Executor E>
  [[nodiscard]] AttemptPtr taken_as_odd(const Sweep& sweep, const E& executor);
  template <Executor E>
  [[nodiscard]] AttemptPtr resting_or(AttemptPtr moving, const Sweep& sweep, const E& executor);
  template <Executor E>
  [[nodiscard]] AttemptPtr registered(const Sweep& sweep, const E& executor);
  template <Executor E>
  [[nodiscard]] AttemptPtr at_unknown_velocity(const Sweep& sweep, const E& executor) const;
  template <Executor E>
  [[nodiscard]] AttemptPtr with_first(const Sweep& sweep, AttemptPtr found, const E& executor);
  template <Executor E>
  void rebuild_map(const FirstSweep& first, const Attempt& second, const E& executor);

  [[nodiscard]] bool believable(const Attempt& attempt) const {
    return attempt.report.accepted() && off(attempt) <= options_.max_correction &&
           attempt.match.matches >= options_.min_match_ratio * static_cast<double>(attempt.clouds.points.size());
  }
  /// Whether prediction and scan are farther apart than both say they may be. At a speed that is not known, they may.
  [[nodiscard]] bool contradicted(const Attempt& attempt) const {
    return !believable(attempt) || (motion_.knew_velocity() && attempt.pose_nis > monitor_.max_pose_nis());
  }
  /// Whether it matches clearly fewer points than scans lately did.
  [[nodiscard]] bool poor(const Attempt& attempt) const {
    return attempt.match_ratio() < options_.poor_match_ratio * usual_match_ratio_;
  }
  [[nodiscard]] Guess predicted(double error) const { return {.state = state(), .error = error}; }
  /// The end of the way as an attempt has found it.
  [[nodiscard]] Guess again(const Attempt& found) const {
    return {.state = found.filter.state(), .error = options_.min_error, .bend = correction(found)};
  }
  /// Where a scan lies that was straightened with the mounting of before: where the LiDAR is now.
  [[nodiscard]] SE3d scan_pose(const InertialState& x) const {
    return T_odom_body(x) * T_body_lidar(x) * T_body_lidar(state()).inverse();
  }
  /// The correction of the predicted pose of the scan, tangent of the latter.
  [[nodiscard]] Vector6d correction(const Attempt& attempt) const {
    return T_odom_body(state()).local(scan_pose(attempt.filter.state()));
  }
  /// How far the prediction put the surroundings from where they were found, metres.
  [[nodiscard]] double off(const Attempt& attempt) const { return moved_distance(correction(attempt), 10); }
  /// How many neighbouring residuals count as one.
  [[nodiscard]] double residuals_per_fact() const {
    return options_.residual_variance > 0 ? 1.0 : options_.scan_to_map.correlated_residuals;
  }
  [[nodiscard]] double expected_error() const;
  /// How the body moves at the end of the way.
  [[nodiscard]] MomentaryMotion end_motion(const InertialState& x) const {
    return {x.get<Inertial::velocity>().value(), motion_.end_rate()};
  }

  Options options_;
  LocalMap<Map> map_;
  InertialMotion motion_;
  ImuMonitor monitor_;
  ScanClock scan_clock_;
  ImuStart imu_start_;
  std::optional<FirstSweep> first_;
  double residual_noise_ = 0.05;  ///< metres, smoothed
  double usual_match_ratio_ = 0;  ///< smoothed
};

template <class Map, class Kernel>
template <Executor E>
auto SweepRegistration<Map, Kernel>::straightened(const Sweep& sweep, const SweepMotion& motion,
                                                  const E& executor) const -> Clouds {
  Clouds clouds;
  const SE3d mounting = motion_.started() ? T_body_lidar(state()) : options_.T_body_lidar;
  clouds.whole = deskew(sweep.points, motion, mounting, executor);
  clouds.map = voxel_downsample(clouds.whole.positions, options_.map_voxel);
  clouds.points = options_.scan_voxel > options_.map_voxel ? voxel_downsample(clouds.map.positions, options_.scan_voxel)
                                                           : clouds.map;
  return clouds;
}

/// Straightens the sweep by the predicted way, and takes it from the prediction.
template <class Map, class Kernel>
template <Executor E>
auto SweepRegistration<Map, Kernel>::attempt(const Sweep& sweep, const Guess& guess, const E& executor) const
    -> AttemptPtr {
  AttemptPtr attempt = std::make_unique<Attempt>();
  attempt->clouds = straightened(sweep, motion_.sweep_motion(sweep.begin, guess.bend), executor);
  attempt->filter = motion_.filter();
  const double noise = std::max(residual_noise_, options_.scan_to_map.residual_floor);
  ScanPrior prior{
      .state = state(),
      .error = guess.error,
      .variance = options_.residual_variance > 0 ? options_.residual_variance : noise * noise * residuals_per_fact(),
      .mean_age = first_ ? 0.0 : sweep.mean_age(),  // a map as skewed as the scan lies at its mean time, too
      .time_deviation = motion_.use() == ImuUse::none ? 0.0 : scan_clock_.deviation(),
      .rate = motion_.end_rate()};
  const Eigen::Vector3d bent = state().template get<Inertial::rotation>() * block_of<3, 1>(guess.bend, 0, 0);
  R3d& velocity = prior.state.template get<Inertial::velocity>();
  velocity = R3d(sum_of(velocity.value(), divided(bent, std::max(motion_.interval(), 1e-3))));
  ScanMeasurement measurement(attempt->clouds.points, map_.points(), options_.scan_to_map, options_.scan, prior,
                              executor);
  attempt->report = attempt->filter.update(measurement, options_.iteration, guess.state);
  attempt->match = measurement.match();
  attempt->own_pose = measurement.own_pose();
  attempt->time_error = measurement.time_error(attempt->filter.state());
  attempt->pose_nis = (attempt->report.prior_error + measurement.excess()) /
                      static_cast<double>(std::max<Index>(1, 6 - attempt->match.degenerate_directions));
  return attempt;
}

/// Takes the scan from the prediction, and as if nothing were known of the motion if it does not fit.
template <class Map, class Kernel>
template <Executor E>
auto SweepRegistration<Map, Kernel>::attempt(const Sweep& sweep, const E& executor) const -> AttemptPtr {
  const double error = expected_error();
  AttemptPtr found = attempt(sweep, predicted(error), executor);
  if (!believable(*found) && error < options_.max_error)
    found = attempt(sweep, predicted(options_.max_error), executor);
  return found;
}

/// Takes the scan at a velocity that is not known. The body may stand, where a wide gate alone might find another place
/// that looks alike, or have moved by metres, where it might not get there: of several attempts that with the most
/// weight of matches is taken.
template <class Map, class Kernel>
template <Executor E>
auto SweepRegistration<Map, Kernel>::at_unknown_velocity(const Sweep& sweep, const E& executor) const -> AttemptPtr {
  AttemptPtr best = attempt(sweep, executor);
  const auto try_from = [&](const Guess& guess) {
    AttemptPtr other = attempt(sweep, guess, executor);
    const bool better = believable(*other) && (!believable(*best) || other->match.weight > best->match.weight);
    if (better) best = std::move(other);
  };
  try_from(predicted(options_.min_error));
  if (TranslationSearch::needless(best->match.weight, best->clouds.points.size())) return best;
  const TranslationSearch search = TranslationSearch::after(motion_.interval());
  const SE3d T_predicted = T_odom_body(state());
  const SE3d T_found = best->match.matches > 0 ? scan_pose(best->filter.state()) : T_predicted;
  const PlaneRule plane = options_.scan_to_map.plane_rule(search.spacing, options_.scan.planes);
  for (const SE3d& T : search(best->clouds.points, map_.points(), plane, T_found, T_predicted.translation(), executor))
    try_from({.state = motion_.moved(T_predicted.local(T)), .error = search.spacing});
  return best;
}

/// Takes the scan from a prediction that it does not contradict: first as if it were an odd one, then from less and
/// less of the IMU's measurements. Where that leaves fewer matches than scans had before, the pose may be that of
/// another place that looks alike: the most matches decide.
template <class Map, class Kernel>
template <Executor E>
auto SweepRegistration<Map, Kernel>::consistent(const Sweep& sweep, const E& executor) -> AttemptPtr {
  if (!monitor_.enabled()) return attempt(sweep, executor);
  const ImuUse before = motion_.use();
  SweepChoice choice{.use = before};
  const auto offer = [&](AttemptPtr found) {
    const bool fits = believable(*found), agrees = !contradicted(*found);
    choice.offer(std::move(found), motion_.use(), fits, agrees);
  };
  offer(motion_.knew_velocity() ? attempt(sweep, executor) : at_unknown_velocity(sweep, executor));
  if (!choice.best && motion_.knew_velocity() && motion_.use() != ImuUse::none && monitor_.may_blame_scans())
    if (AttemptPtr odd = taken_as_odd(sweep, executor)) return odd;
  for (const ImuUse use : {ImuUse::gyroscope, ImuUse::rough_gyroscope, ImuUse::none}) {
    if (choice.best && !poor(*choice.best)) break;
    if (use <= motion_.use() || (use != ImuUse::none && motion_.measured_share() == 0)) continue;
    motion_.predict_again(use);
    offer(attempt(sweep, executor));
  }
  if (choice.best && poor(*choice.best) && motion_.use() == ImuUse::none)
    for (const double share : {0.0, 0.5}) {  // of the predicted way: bodies stop faster than they start
      const Vector6d way = motion_.way_begin().local(T_odom_body(state()));
      offer(attempt(sweep, {.state = motion_.moved(scaled(share - 1, way)), .error = options_.max_error}, executor));
    }
  if (choice.best) {
    if (choice.use != motion_.use()) motion_.predict_again(choice.use);
    return std::move(choice.best);
  }
  motion_.doubt_motion();
  AttemptPtr doubted = attempt(sweep, predicted(options_.max_error), executor);
  if (!believable(*doubted))
    motion_.restore(before);  // it may be the scan that is at fault: the IMU carries the motion on
  return doubted;
}

/// Takes the scan for where it lies, and keeps the motion that was predicted; nothing if that does not help or has been
/// done too often.
template <class Map, class Kernel>
template <Executor E>
auto SweepRegistration<Map, Kernel>::taken_as_odd(const Sweep& sweep, const E& executor) -> AttemptPtr {
  const InertialMotion::Filter before = motion_.filter();
  motion_.doubt_place();
  AttemptPtr found = attempt(sweep, executor);
  const Eigen::Vector3d off = difference_of(found->filter.state().template get<Inertial::position>().value(),
                                            state().template get<Inertial::position>().value());
  if (!contradicted(*found) && monitor_.blames_scan(off)) {
    found->odd = off;
    return found;
  }
  motion_.filter() = before;
  return nullptr;
}

/// Takes the scan as if the body stood still, as the IMU's quiet measurements allow: but they are as quiet at a steady
/// speed. It moves if the scan matches clearly more that way.
template <class Map, class Kernel>
template <Executor E>
auto SweepRegistration<Map, Kernel>::resting_or(AttemptPtr moving, const Sweep& sweep, const E& executor)
    -> AttemptPtr {
  constexpr double clearly = 1.05;
  const InertialMotion::Filter before = motion_.filter();
  motion_.assume_rest();
  AttemptPtr resting = attempt(sweep, executor);
  if (moving->match.weight <= clearly * resting->match.weight) return resting;
  motion_.filter() = before;
  return moving;
}

/// Takes the scan; once more if that left it skewed, unless it then matches less.
template <class Map, class Kernel>
template <Executor E>
auto SweepRegistration<Map, Kernel>::registered(const Sweep& sweep, const E& executor) -> AttemptPtr {
  AttemptPtr found = consistent(sweep, executor);
  if (!believable(*found) || !sweep.points.has_times()) {
    first_.reset();
    return found;
  }
  constexpr double poor = 20;  // of the least signal that counts: the scan hardly tells a velocity
  if (first_ && imu_start_.at_rest && found->match.signal[0] < poor * options_.scan_to_map.min_signal)
    found = resting_or(std::move(found), sweep, executor);
  if (first_) found = with_first(sweep, std::move(found), executor);
  constexpr double lever = 20;  // metres: points that far off
  const Guess bent = again(*found);
  const double share = to_seconds(sweep.end - sweep.begin) / std::max(motion_.interval(), 1e-3);
  constexpr double most = 2;  // a way much shorter than the sweep does not show how that moved
  if (!believable(*found) || found->is_odd() || share > most ||
      std::min(share, 1.0) * moved_distance(bent.bend, lever) <= options_.redeskew_distance)
    return found;
  AttemptPtr other = attempt(sweep, bent, executor);
  // A correction of errors from before this way skews the scan, which then matches less.
  const bool worse = motion_.knew_velocity() && other->match.weight < found->match.weight;
  return worse ? std::move(found) : std::move(other);
}

/// The second scan, and the first by the motion that it shows, in turn until that motion stays.
template <class Map, class Kernel>
template <Executor E>
auto SweepRegistration<Map, Kernel>::with_first(const Sweep& sweep, AttemptPtr found, const E& executor) -> AttemptPtr {
  constexpr int max_passes = 4;
  constexpr double lever = 20;  // metres
  const FirstSweep first = *std::exchange(first_, std::nullopt);
  for (int pass = 0; pass < max_passes && believable(*found); ++pass) {
    rebuild_map(first, *found, executor);
    const Guess bent = again(*found);
    found = attempt(sweep, bent, executor);
    if (moved_distance(difference_of(correction(*found), bent.bend), lever) < options_.redeskew_distance) break;
  }
  return found;
}

/// Straightens the first scan by the motion that the second has shown, and builds the map from it again.
template <class Map, class Kernel>
template <Executor E>
void SweepRegistration<Map, Kernel>::rebuild_map(const FirstSweep& first, const Attempt& second, const E& executor) {
  const auto velocity = [](const InertialState& x) { return x.get<Inertial::velocity>().value(); };
  const Eigen::Vector3d rate_change =
      divided(block_of<3, 1>(correction(second), 3, 0), std::max(motion_.interval(), 1e-3));
  const Vector6d twist =
      motion_.twist_at_begin(difference_of(velocity(second.filter.state()), velocity(state())), rate_change);
  map_.clear();
  map_.extend(straightened(first.sweep, first.turn.with(twist), executor).map, motion_.way_begin());
}

/// Three standard deviations of where the filter puts a near wall.
template <class Map, class Kernel>
double SweepRegistration<Map, Kernel>::expected_error() const {
  constexpr double lever = 10;  // metres
  const Vector6d variances = lidar_pose_variances(state(), covariance());
  const double by_time = scan_clock_.deviation() * state().template get<Inertial::velocity>().value().norm();
  const double error = 3 * (std::sqrt(variances[0] + variances[1] + variances[2] + by_time * by_time) +
                            lever * std::sqrt(variances[3] + variances[4] + variances[5]));
  return std::clamp(error, options_.min_error, options_.max_error);
}

}  // namespace chainslam::detail
