#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <deque>
#include <optional>
#include <type_traits>
#include <utility>
#include <variant>

#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/compiled.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/map/frame.hpp"
#include "chainslam/odometry/deskew.hpp"
#include "chainslam/odometry/detail/moved_distance.hpp"
#include "chainslam/odometry/inertial_motion.hpp"
#include "chainslam/odometry/leveller.hpp"
#include "chainslam/odometry/lidar_inertial_options.hpp"
#include "chainslam/odometry/local_map.hpp"
#include "chainslam/odometry/odometry_counts.hpp"
#include "chainslam/odometry/scan_filter.hpp"
#include "chainslam/odometry/scan_measurement.hpp"
#include "chainslam/odometry/scan_to_map.hpp"
#include "chainslam/search/voxel_map.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam {

/// LiDAR-inertial odometry: an iterated filter (FAST-LIO2, Xu et al. 2022) that integrates the inertial unit from scan
/// to scan, straightens each scan by that motion and corrects itself by the scan's distances to planes of a local map.
///
/// The first pose is the origin of `odom`, +z against gravity as well as it is known then. A scan waits for the first
/// reading after its end, until another scan comes or `flush` is called; so its frame may come with a later packet.
/// - Without readings for 0.25 s, and without an inertial unit at all, velocity and rate stay as they were, held by the
///   scans alone; after more than a second without either, velocity and position are as good as unknown.
/// - Readings at the end of their range count for little.
/// - Directions that a scan does not see are left to the prediction.
/// - The local map, to which scans are held, creeps out of level; gravity shows it, and the poses are kept level.
/// - Empty, late and lost scans leave the traces of `LidarOdometry`.
/// Same packets, same bits, whatever the executor. Poses are always finite. Nothing grows with the length of the drive.
///
/// @tparam Map  a map that grows and thins itself, made from its `downsampling()`: `VoxelMap`, `IkdTree`.
template <class Map = VoxelMap<float>, class Kernel = GemanMcClure>
class LidarInertialOdometry {
  static_assert(IncrementalSearch<Map>,
                "LidarInertialOdometry: Map needs what grows, forgets and finds, as in VoxelMap");

 public:
  using Options = LidarInertialOdometryOptions<Kernel, typename LocalMap<Map>::Downsampling>;

  explicit LidarInertialOdometry(Options options = {})
      : options_(std::move(options)),
        map_(options_.map, options_.local_map),
        motion_(options_.motion, options_.T_body_lidar) {}

  /// Takes the next packet, in time order. @returns the next frame, if one is complete: at the end of a usable scan.
  /// @throws std::invalid_argument if a scan's columns do not match.
  template <Executor E = Serial>
  std::optional<Frame> process(const Packet& packet, const E& executor = {});

  /// After the last packet: the frames of scans that still wait for readings, one a call, then nothing.
  template <Executor E = Serial>
  std::optional<Frame> flush(const E& executor = {});

  [[nodiscard]] LidarInertialOdometryCounts counts() const {
    LidarInertialOdometryCounts counts = counts_;
    counts.clipped_imu_samples = motion_.imu().clipped_samples();
    counts.evicted_points = map_.evicted();
    return counts;
  }
  [[nodiscard]] const ImuStart& imu_start() const { return imu_start_; }
  /// In the frame of the local map, which scans hold to itself; `T_odom_map` turns it level.
  [[nodiscard]] const InertialState& state() const { return motion_.state(); }
  [[nodiscard]] const SE3d& T_odom_map() const { return leveller_.T_odom_map(); }
  [[nodiscard]] const InertialState::Jacobian& covariance() const { return motion_.filter().covariance(); }
  [[nodiscard]] const InertialHealth& health() const { return health_; }
  [[nodiscard]] const Map& local_map() const { return map_.points(); }  ///< in its own frame

 private:
  struct Sweep {
    Timestamp begin, end;
    PointCloud<float> points;  ///< usable ones, lidar frame

    /// Seconds from the points' mean time to the sweep's end.
    [[nodiscard]] double mean_age() const {
      if (!points.has_times()) return 0;
      double sum = 0;
      for (const float offset : points.time_offsets) sum += static_cast<double>(offset);
      const double duration = to_seconds(end - begin);
      return std::clamp(duration - sum / static_cast<double>(points.size()), 0.0, duration);
    }
  };
  struct Clouds {
    PointCloud<float> whole;        ///< body frame at the sweep's end
    PointCloud<float> map, points;  ///< of these, for the map and for the filter
  };
  /// A scan, straightened and measured.
  struct Attempt {
    Clouds clouds;
    InertialMotion::Filter filter;
    FilterReport<InertialState> report;
    ScanMatch match;
  };

  template <Executor E>
  std::optional<Frame> next_frame(const E& executor);
  template <Executor E>
  std::optional<Frame> start(Sweep sweep, const E& executor);
  template <Executor E>
  [[nodiscard]] Clouds straightened(const Sweep& sweep, const SweepMotion& motion, const E& executor) const;
  template <Executor E>
  [[nodiscard]] Attempt attempt(const Sweep& sweep, const Vector6d& correction, double error, const E& executor) const;
  template <Executor E>
  [[nodiscard]] Attempt registered(const Sweep& sweep, const E& executor);
  template <Executor E>
  void rebuild_map(const Sweep& first, const Attempt& second, const E& executor);
  [[nodiscard]] Frame follow(Attempt attempt);
  [[nodiscard]] Frame lose(Attempt attempt);
  [[nodiscard]] Frame answer(Attempt& attempt, FrameStatus status) const;

  [[nodiscard]] bool believable(const Attempt& attempt) const {
    return attempt.report.accepted() && off(attempt) <= 2 * options_.max_error &&
           attempt.match.matches >= options_.min_match_ratio * static_cast<double>(attempt.clouds.points.size());
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
  [[nodiscard]] double off(const Attempt& attempt) const { return detail::moved_distance(correction(attempt), 10); }
  /// How many neighbouring residuals count as one.
  [[nodiscard]] double residuals_per_fact() const {
    return options_.residual_variance > 0 ? 1.0 : options_.scan_to_map.correlated_residuals;
  }
  [[nodiscard]] double expected_error() const;
  void bound_mounting();

  Options options_;
  LidarInertialOdometryCounts counts_;
  LocalMap<Map> map_;
  InertialMotion motion_;
  Leveller leveller_;
  ImuStart imu_start_;
  InertialHealth health_;
  std::deque<Sweep> waiting_;   ///< for readings: at most two
  std::optional<Sweep> first_;  ///< the first scan, until the motion during it is known
  Index lost_in_a_row_ = 0;
  double residual_noise_ = 0.05;  ///< metres, smoothed
};

template <class Map, class Kernel>
template <Executor E>
std::optional<Frame> LidarInertialOdometry<Map, Kernel>::process(const Packet& packet, const E& executor) {
  if (const auto* sample = std::get_if<ImuSample>(&packet)) {
    const ImuRecord::Taken taken = motion_.add(*sample);
    if (taken == ImuRecord::Taken::dropped) ++counts_.dropped_imu_samples;
    if (taken == ImuRecord::Taken::restarted) ++counts_.imu_restarts;
  }
  if (const auto* scan = std::get_if<LidarScan>(&packet)) {
    ++counts_.scans;
    waiting_.push_back({scan->time, scan->end, options_.filter.apply(scan->cloud, counts_.points)});
  }
  if (waiting_.empty()) return std::nullopt;
  const Timestamp end = waiting_.front().end;
  const bool wait = waiting_.size() == 1 && !motion_.imu().reaches(end) && motion_.imu().may_reach(end);
  return wait ? std::nullopt : next_frame(executor);
}

template <class Map, class Kernel>
template <Executor E>
std::optional<Frame> LidarInertialOdometry<Map, Kernel>::flush(const E& executor) {
  while (!waiting_.empty())
    if (auto frame = next_frame(executor)) return frame;
  return std::nullopt;
}

template <class Map, class Kernel>
template <Executor E>
std::optional<Frame> LidarInertialOdometry<Map, Kernel>::next_frame(const E& executor) {
  Sweep sweep = std::move(waiting_.front());
  waiting_.pop_front();
  if (sweep.begin > sweep.end || (motion_.started() && sweep.end <= motion_.time())) {
    ++counts_.out_of_order_scans;
    return std::nullopt;
  }
  if (!motion_.started()) return start(std::move(sweep), executor);
  if (to_index(sweep.points.size()) < options_.min_points) {
    ++counts_.empty_scans;
    return std::nullopt;
  }
  const double since_last = to_seconds(sweep.end - motion_.time());
  motion_.predict(sweep.end);
  Attempt found = registered(sweep, executor);
  ++counts_.frames;
  if (since_last > options_.motion.max_free) ++counts_.gaps;
  ++(motion_.measured_share() > 0.5 ? counts_.gyro_scans : counts_.unmeasured_scans);
  return believable(found) ? follow(std::move(found)) : lose(std::move(found));
}

template <class Map, class Kernel>
template <Executor E>
std::optional<Frame> LidarInertialOdometry<Map, Kernel>::start(Sweep sweep, const E& executor) {
  Attempt first;
  first.clouds =
      straightened(sweep, SweepMotion::constant_twist(to_seconds(sweep.end - sweep.begin), Vector6d::Zero()), executor);
  if (to_index(first.clouds.points.size()) < options_.min_points) {
    ++counts_.empty_scans;
    return std::nullopt;
  }
  ++counts_.frames;
  imu_start_ = motion_.start(sweep.end);
  first.filter = motion_.filter();
  map_.extend(first.clouds.map, T_odom_body(state()));
  if (sweep.points.has_times()) first_ = std::move(sweep);
  Frame frame = answer(first, FrameStatus::good);
  constexpr double anchored = 1e-12;  // m^2, rad^2: the first pose is the origin by definition
  frame.covariance.setZero();
  for (int i = 0; i < 6; ++i) frame.covariance(i, i) = anchored;
  return frame;
}

template <class Map, class Kernel>
template <Executor E>
auto LidarInertialOdometry<Map, Kernel>::straightened(const Sweep& sweep, const SweepMotion& motion,
                                                      const E& executor) const -> Clouds {
  Clouds clouds;
  const SE3d mounting = motion_.started() ? T_body_lidar(state()) : options_.T_body_lidar;
  clouds.whole = deskew(sweep.points, motion, mounting, executor);
  clouds.map = voxel_downsample(clouds.whole, options_.map_voxel);
  clouds.points =
      options_.scan_voxel > options_.map_voxel ? voxel_downsample(clouds.map, options_.scan_voxel) : clouds.map;
  return clouds;
}

/// Straightens the sweep by the predicted way, bent to end `correction` off, and takes it from the prediction.
template <class Map, class Kernel>
template <Executor E>
auto LidarInertialOdometry<Map, Kernel>::attempt(const Sweep& sweep, const Vector6d& correction, double error,
                                                 const E& executor) const -> Attempt {
  Attempt attempt;
  attempt.clouds = straightened(sweep, motion_.sweep_motion(sweep.begin, correction), executor);
  attempt.filter = motion_.filter();
  const double noise = std::max(residual_noise_, options_.scan_to_map.residual_floor);
  ScanPrior prior{
      .state = state(),
      .error = error,
      .variance = options_.residual_variance > 0 ? options_.residual_variance : noise * noise * residuals_per_fact(),
      .mean_age = first_ ? 0.0 : sweep.mean_age()};  // a map as skewed as the scan lies at its mean time, too
  const Eigen::Vector3d bent = state().template get<Inertial::rotation>() * block_of<3, 1>(correction, 0, 0);
  R3d& velocity = prior.state.template get<Inertial::velocity>();
  velocity = R3d(velocity.value() + bent / std::max(motion_.interval(), 1e-3));
  ScanMeasurement measurement(attempt.clouds.points, map_.points(), options_.scan_to_map, options_.scan, prior,
                              executor);
  attempt.report = attempt.filter.update(measurement, options_.iteration);
  attempt.match = measurement.match();
  return attempt;
}

/// Takes the scan from the prediction; once more if that left it skewed, and as if nothing were known of the motion if
/// it did not fit.
template <class Map, class Kernel>
template <Executor E>
auto LidarInertialOdometry<Map, Kernel>::registered(const Sweep& sweep, const E& executor) -> Attempt {
  const double error = expected_error();
  Attempt found = attempt(sweep, Vector6d::Zero(), error, executor);
  if (!believable(found) && error < options_.max_error)
    found = attempt(sweep, Vector6d::Zero(), options_.max_error, executor);
  if (!believable(found) || !sweep.points.has_times()) {
    first_.reset();
    return found;
  }
  constexpr double poor = 20;  // of the least signal that counts: the scan hardly tells a velocity
  if (first_ && imu_start_.at_rest && found.match.signal[0] < poor * options_.scan_to_map.min_signal) {
    motion_.assume_rest();
    found = attempt(sweep, Vector6d::Zero(), error, executor);
  }
  Vector6d bent = correction(found);
  if (first_) {
    rebuild_map(*std::exchange(first_, std::nullopt), found, executor);
    found = attempt(sweep, bent, options_.min_error, executor);
    bent = correction(found);
  }
  constexpr double lever = 20;  // metres: points that far off
  const double share = to_seconds(sweep.end - sweep.begin) / std::max(motion_.interval(), 1e-3);
  if (believable(found) && std::min(share, 1.0) * detail::moved_distance(bent, lever) > options_.redeskew_distance)
    found = attempt(sweep, bent, options_.min_error, executor);
  return found;
}

/// Straightens the first scan by the motion that the second has shown, and builds the map from it again.
template <class Map, class Kernel>
template <Executor E>
void LidarInertialOdometry<Map, Kernel>::rebuild_map(const Sweep& first, const Attempt& second, const E& executor) {
  const auto velocity = [](const InertialState& x) { return x.get<Inertial::velocity>().value(); };
  const SweepMotion motion =
      motion_.motion_before(to_seconds(first.end - first.begin), velocity(second.filter.state()) - velocity(state()));
  map_.clear();
  map_.extend(straightened(first, motion, executor).map, motion_.way_begin());
}

template <class Map, class Kernel>
Frame LidarInertialOdometry<Map, Kernel>::follow(Attempt attempt) {
  const SE3d T_odom_scan = scan_pose(attempt.filter.state());
  motion_.filter() = attempt.filter;
  leveller_.follow(state());
  motion_.follow();
  bound_mounting();
  map_.extend(attempt.clouds.map, T_odom_scan);
  lost_in_a_row_ = 0;
  constexpr double memory = 0.9;
  residual_noise_ = std::sqrt(memory * residual_noise_ * residual_noise_ +
                              (1 - memory) * attempt.match.residual_rms * attempt.match.residual_rms);
  const bool degenerate = attempt.match.degenerate_directions > 0;
  if (degenerate) ++counts_.degenerate_scans;
  health_ = {.update = attempt.report.status,
             .nis = attempt.report.nis * residuals_per_fact() / std::max(1, attempt.report.nis_residuals),
             .degenerate_directions = attempt.match.degenerate_directions,
             .signal = attempt.match.signal,
             .measured_share = motion_.measured_share()};
  return answer(attempt, degenerate ? FrameStatus::degenerate : FrameStatus::good);
}

template <class Map, class Kernel>
Frame LidarInertialOdometry<Map, Kernel>::lose(Attempt attempt) {
  attempt.filter = motion_.filter();
  ++counts_.lost_scans;
  health_ = {.update = attempt.report.status, .measured_share = motion_.measured_share()};
  if (++lost_in_a_row_ > options_.max_lost_scans) {
    ++counts_.map_restarts;
    map_.clear();
    map_.extend(attempt.clouds.map, T_odom_body(state()));
  }
  return answer(attempt, FrameStatus::lost);
}

template <class Map, class Kernel>
Frame LidarInertialOdometry<Map, Kernel>::answer(Attempt& attempt, FrameStatus status) const {
  Frame frame;
  frame.time = motion_.time();
  frame.T_odom_body = leveller_.T_odom_map() * T_odom_body(state());
  frame.covariance = pose_covariance(state(), covariance());
  frame.health = {.status = status,
                  .points = to_index(attempt.clouds.points.size()),
                  .matches = attempt.match.matches,
                  .residual_rms = attempt.match.residual_rms,
                  .iterations = attempt.match.iterations};
  frame.cloud = std::move(attempt.clouds.whole);
  return frame;
}

/// Three standard deviations of where the filter puts a near wall.
template <class Map, class Kernel>
double LidarInertialOdometry<Map, Kernel>::expected_error() const {
  constexpr double lever = 10;  // metres
  const Eigen::Matrix<double, 6, InertialState::dof> by_state = lidar_pose_jacobian(state());
  const Eigen::Matrix<double, 6, InertialState::dof> weighted = product(by_state, covariance());
  Vector6d variances = Vector6d::Zero();
  for (int j = 0; j < InertialState::dof; ++j)
    for (int i = 0; i < 6; ++i) variances[i] += weighted(i, j) * by_state(i, j);
  const double error = 3 * (std::sqrt(variances[0] + variances[1] + variances[2]) +
                            lever * std::sqrt(variances[3] + variances[4] + variances[5]));
  return std::clamp(error, options_.min_error, options_.max_error);
}

/// A mounting that was estimated too far from the one given is given up, and held from then on.
template <class Map, class Kernel>
void LidarInertialOdometry<Map, Kernel>::bound_mounting() {
  const Vector6d off = options_.T_body_lidar.local(T_body_lidar(state()));
  if (block_of<3, 1>(off, 0, 0).norm() <= options_.max_mounting_position &&
      block_of<3, 1>(off, 3, 0).norm() <= options_.max_mounting_rotation)
    return;
  ++counts_.mounting_resets;
  InertialState x = state();
  const SE3d T_odom = T_odom_body(x) * T_body_lidar(x) * options_.T_body_lidar.inverse();  // the LiDAR stays in the map
  x.get<Inertial::position>() = R3d(T_odom.translation());
  x.get<Inertial::rotation>() = T_odom.rotation();
  x.get<Inertial::lidar_position>() = R3d(options_.T_body_lidar.translation());
  x.get<Inertial::lidar_rotation>() = options_.T_body_lidar.rotation();
  InertialState::Jacobian P = covariance();
  for (int i = InertialState::dof - 6; i < InertialState::dof; ++i)
    for (int j = 0; j < InertialState::dof; ++j) P(i, j) = P(j, i) = 0;
  motion_.filter().reset(x, P);
}

#ifdef CHAINSLAM_COMPILED
extern template class LidarInertialOdometry<>;
extern template std::optional<Frame> LidarInertialOdometry<>::process(const Packet&, const Serial&);
extern template std::optional<Frame> LidarInertialOdometry<>::process(const Packet&, const ThreadPool&);
extern template std::optional<Frame> LidarInertialOdometry<>::flush(const Serial&);
extern template std::optional<Frame> LidarInertialOdometry<>::flush(const ThreadPool&);
#endif

}  // namespace chainslam
