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
#include "chainslam/odometry/deskew.hpp"
#include "chainslam/odometry/detail/delta_velocity.hpp"
#include "chainslam/odometry/detail/first_sweep.hpp"
#include "chainslam/odometry/detail/inertial_motion.hpp"
#include "chainslam/odometry/detail/moved_distance.hpp"
#include "chainslam/odometry/detail/pose_doubt.hpp"
#include "chainslam/odometry/detail/scan_measurement.hpp"
#include "chainslam/odometry/detail/sweep.hpp"
#include "chainslam/odometry/detail/sweep_registration.hpp"
#include "chainslam/odometry/detail/tilt_correction.hpp"
#include "chainslam/odometry/imu_alignment.hpp"
#include "chainslam/odometry/lidar_inertial_options.hpp"
#include "chainslam/odometry/odometry_source.hpp"
#include "chainslam/odometry/scan_to_map.hpp"
#include "chainslam/search/voxel_map.hpp"
#include "chainslam/sensor/frame.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam {

/// LiDAR-inertial odometry: an iterated filter (FAST-LIO2, Xu et al. 2022) that integrates the IMU from scan
/// to scan, undistorts each scan by that motion and corrects itself by the scan's distances to planes of a local map.
///
/// The first pose is the origin of `odom`, +z against gravity as well as it is known then. A scan waits for the first
/// reading after its end, at most until three more scans have come or `flush` is called; so its frame may come with a
/// later packet.
/// - The body may move from the first scan on, by up to 45 m/s. The second scan shows the velocity, by which the first
///   one's points are undistorted for the local map, and all poses are correct when they are returned. Only the cloud
///   of the first frame, returned before that, is undistorted by the gyroscope alone.
/// - Without measurements for 0.25 s, and without an IMU at all, velocity and rate stay as they were, held by the
///   scans alone; after more than a second without either, velocity and position are as good as unknown.
/// - Where scan and prediction contradict each other, a scan's time may be wrong, or its registration: it is taken for
///   where it lies, but velocity and biases are kept. If that comes again and again or does not help, less of the IMU
///   is used for that interval: the gyroscope without the accelerometer, the gyroscope roughly, the scans alone
///   (`InertialHealth::imu_use`). A sensor that is contradicted again and again is left out until it agrees with the
///   scans for a while (`ImuMonitor`).
/// - The times of scans may be off by some milliseconds each: by how much is learnt (`ScanClock`), and the error of
///   each scan estimated. Poses are those at the stated times, and frames' clouds lie where the body was then.
/// - The accelerometer's noise is learnt from how it differs from the scans' motion over half a second (`AccelNoise`).
/// - Measurements at the end of their range count for little. What an IMU cannot have measured is rejected
/// (`ImuCheck`).
/// - Directions that a scan does not see are left to the prediction.
/// - The local map, to which scans are held, slowly tilts; gravity makes the tilt observable, and poses are
/// gravity-aligned.
/// - Empty, late and lost scans leave the traces of `LidarOdometry`.
/// Deterministic: bit-identical for any executor. Poses are always finite. Bounded memory.
///
/// @tparam Map  a growing map that downsamples itself, made from its `downsampling()`: `VoxelMap`, `IkdTree`.
template <class Map = VoxelMap<float>, class Kernel = GemanMcClure>
class LidarInertialOdometry : private detail::SweepRegistration<Map, Kernel> {
  using Registration = detail::SweepRegistration<Map, Kernel>;

  static_assert(IncrementalSearch<Map>,
                "LidarInertialOdometry: Map needs what grows, forgets and finds, as in VoxelMap; see "
                "chainslam/search/concepts.hpp");

 public:
  using Options = typename Registration::Options;  ///< its settings

  /// Starts without a map.
  explicit LidarInertialOdometry(const Options& options = {}) : Registration(options), imu_check_(options_.imu_check) {}

  /// Takes the next packet, in time order. @returns the next frame, if one is complete: at the end of a usable scan.
  /// @throws std::invalid_argument if a scan's columns do not match.
  template <Executor E = Serial>
  std::optional<Frame> process(const Packet& packet, const E& executor = {});

  /// After the last packet: the frames of scans that still wait for measurements, one a call, then nothing.
  template <Executor E = Serial>
  std::optional<Frame> flush(const E& executor = {});

  /// Corrects IMU samples from now on. What was learnt from them with axes or a clock that were clearly wrong is
  /// forgotten. @param up  against gravity in odom, where it is known apart from the filter.
  /// @param axes_deviation  of axes that differ from those before, rad about each of them.
  void correct_imu(const ImuCorrection& correction, const std::optional<Eigen::Vector3d>& up = std::nullopt,
                   double axes_deviation = 0);
  /// How IMU samples are corrected.
  [[nodiscard]] const ImuCorrection& imu_correction() const { return motion_.imu().correction(); }
  /// Of the last scan by registration alone, as far as the scan shows it; in the local map's frame.
  [[nodiscard]] const SE3d& T_map_lidar() const { return T_map_lidar_; }
  /// What the filter has found of R_body_lidar, in the body's axes as corrected; nothing unless the IMU is in use.
  [[nodiscard]] RotationEvidence mounting_evidence() const {
    const bool believed = monitor_.use() == ImuUse::all && options_.imu_use == ImuUse::all;
    return believed ? motion_.mounting_evidence() : RotationEvidence{.about = options_.T_body_lidar.rotation()};
  }
  [[nodiscard]] const detail::ImuMonitor& imu_monitor() const { return monitor_; }  ///< what of the IMU is in use
  /// Seconds, standard deviation of the times of scans, as learnt so far; 0: they are taken as exact.
  [[nodiscard]] double scan_time_deviation() const { return this->scan_clock_.deviation(); }
  /// What became of scans, points and IMU samples so far.
  [[nodiscard]] LidarInertialOdometryCounts counts() const {
    LidarInertialOdometryCounts counts = counts_;
    counts.imu = imu_check_.counts();
    counts.clipped_imu_samples = motion_.imu().clipped_samples();
    counts.evicted_points = map_.evicted();
    return counts;
  }
  /// What was known of the IMU at the first scan.
  [[nodiscard]] const ImuStart& imu_start() const { return imu_start_; }
  /// In the frame of the local map, which scans hold to itself; `T_odom_map` turns it level.
  [[nodiscard]] const InertialState& state() const { return Registration::state(); }
  [[nodiscard]] const SE3d& T_odom_map() const {
    return tilt_correction_.T_odom_map();
  }  ///< levels the local map's frame
  /// Covariance of `state()` in its tangent space.
  [[nodiscard]] const InertialState::Jacobian& covariance() const { return Registration::covariance(); }
  [[nodiscard]] const InertialHealth& health() const { return health_; }  ///< of the last frame
  [[nodiscard]] const Map& local_map() const { return map_.points(); }    ///< in its own frame

 private:
  using Sweep = detail::Sweep;
  using Registration::believable, Registration::imu_start_, Registration::map_, Registration::monitor_,
      Registration::motion_, Registration::options_, Registration::scan_clock_;
  using typename Registration::Attempt;

  template <Executor E>
  std::optional<Frame> next_frame(const E& executor);
  template <Executor E>
  std::optional<Frame> start(Sweep sweep, const E& executor);
  [[nodiscard]] Frame follow(Attempt& attempt);
  void watch_imu(const Attempt& attempt, const Eigen::Vector3d& scanned_at);
  [[nodiscard]] bool clock_was_to_blame();
  void forget_imu(const std::optional<Eigen::Vector3d>& up);
  static void bring_to_stated_time(PointCloud<float>& cloud, const SE3d& T_end_scan);
  [[nodiscard]] Frame lose(Attempt& attempt, double since_last);
  [[nodiscard]] Frame answer(Attempt& attempt, FrameStatus status) const;

  static constexpr std::size_t max_waiting = 4;  // scans: stamps may be late by two scans of 10 Hz, and a bit

  LidarInertialOdometryCounts counts_;
  ImuCheck imu_check_;
  detail::TiltCorrection tilt_correction_;
  detail::PoseDoubt doubt_;
  InertialHealth health_;
  std::deque<Sweep> waiting_;  ///< for measurements up to their ends
  Index lost_in_a_row_ = 0;
  double blamed_deviation_ = 0;  ///< seconds, of the times of scans when the IMU was last forgiven
  SE3d T_map_lidar_;
};

template <class Map, class Kernel>
template <Executor E>
std::optional<Frame> LidarInertialOdometry<Map, Kernel>::process(const Packet& packet, const E& executor) {
  if (const auto* sample = std::get_if<ImuSample>(&packet); sample != nullptr && options_.imu_use != ImuUse::none)
    imu_check_.add(*sample, [&](ImuSample checked) {
      if (options_.imu_use != ImuUse::all) checked.force_measured = false;
      if (motion_.add(checked) == detail::ImuRecord::Taken::restarted) ++counts_.imu_restarts;
    });
  if (const auto* scan = std::get_if<LidarScan>(&packet)) {
    ++counts_.scans;
    waiting_.push_back({scan->time, scan->end, options_.filter.apply(scan->cloud, counts_.points)});
  }
  if (waiting_.empty()) return std::nullopt;
  const Timestamp end = waiting_.front().end;
  const bool wait = waiting_.size() < max_waiting && !motion_.imu().reaches(end) && motion_.imu().may_reach(end);
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
  motion_.predict(sweep.end, std::max(monitor_.use(), options_.imu_use));
  const typename Registration::AttemptPtr found = this->registered(sweep, executor);
  ++counts_.frames;
  const bool gap = since_last > options_.motion.max_free, measured = motion_.measured_share() > 0.5;
  if (gap) ++counts_.gaps;
  if (motion_.use() == ImuUse::gyroscope && options_.imu_use == ImuUse::all) ++counts_.rejected_accelerations;
  if (motion_.use() > ImuUse::gyroscope) ++counts_.rejected_rates;
  ++(measured ? counts_.gyro_scans : counts_.unmeasured_scans);
  Frame frame = believable(*found) ? follow(*found) : lose(*found, since_last);
  frame.health.after_gap = gap && !measured;
  return frame;
}

template <class Map, class Kernel>
template <Executor E>
std::optional<Frame> LidarInertialOdometry<Map, Kernel>::start(Sweep sweep, const E& executor) {
  Attempt first;
  const ImuStart start = options_.motion.initializer.estimate(motion_.imu().samples());
  detail::GyroTurn turn(motion_.imu(), sweep.begin, sweep.end, start.gyro_bias);
  first.clouds = this->straightened(sweep, turn.with(zeros<Vector6d>()), executor);
  if (to_index(first.clouds.points.size()) < options_.min_points) {
    ++counts_.empty_scans;
    return std::nullopt;
  }
  ++counts_.frames;
  imu_start_ = motion_.start(sweep.end);
  first.filter = motion_.filter();
  map_.extend(first.clouds.map, T_odom_body(state()));
  if (sweep.points.has_times()) this->first_ = detail::FirstSweep{std::move(sweep), std::move(turn)};
  Frame frame = answer(first, FrameStatus::good);
  frame.covariance = detail::anchored_covariance();
  return frame;
}

template <class Map, class Kernel>
Frame LidarInertialOdometry<Map, Kernel>::follow(Attempt& attempt) {
  const detail::MomentaryMotion moving = this->end_motion(attempt.filter.state());
  const SE3d T_odom_end = this->scan_pose(attempt.filter.state());  // at the stated time
  const SE3d T_odom_scan = moving.later(T_odom_end, attempt.time_error);
  const Eigen::Vector3d scanned_at = attempt.own_pose.translation();
  T_map_lidar_ = attempt.own_pose * T_body_lidar(state());
  attempt.own_pose = moving.later(attempt.own_pose, -attempt.time_error);
  motion_.filter() = attempt.filter;
  tilt_correction_.follow(state());
  motion_.follow();
  monitor_.count_odd(attempt.odd);
  counts_.odd_scans += attempt.is_odd() ? 1 : 0;
  watch_imu(attempt, scanned_at);
  if (motion_.bound_mounting(options_.max_mounting_position, options_.max_mounting_rotation)) ++counts_.mounting_resets;
  map_.extend(attempt.clouds.map, T_odom_scan);
  bring_to_stated_time(attempt.clouds.whole, T_odom_end.inverse() * T_odom_scan);
  doubt_.match();
  lost_in_a_row_ = 0;
  constexpr double memory = 0.9;
  const double ratio = attempt.match_ratio();
  this->usual_match_ratio_ =
      this->usual_match_ratio_ > 0 ? memory * this->usual_match_ratio_ + (1 - memory) * ratio : ratio;
  this->residual_noise_ = std::sqrt(memory * this->residual_noise_ * this->residual_noise_ +
                                    (1 - memory) * attempt.match.residual_rms * attempt.match.residual_rms);
  const bool degenerate = attempt.match.degenerate_directions > 0;
  if (degenerate) ++counts_.degenerate_scans;
  health_ = {.update = attempt.report.status,
             .nis = attempt.report.nis * this->residuals_per_fact() / std::max(1, attempt.report.nis_residuals),
             .degenerate_directions = attempt.match.degenerate_directions,
             .signal = attempt.match.signal,
             .measured_share = motion_.measured_share(),
             .pose_nis = attempt.pose_nis,
             .imu_use = motion_.use(),
             .accel_noise = motion_.accel_noise(),
             .time_error = attempt.time_error,
             .time_deviation = scan_clock_.deviation()};
  return answer(attempt, degenerate ? FrameStatus::degenerate : FrameStatus::good);
}

/// Moves the cloud of a scan that was taken at another time than stated to where the body was then.
template <class Map, class Kernel>
void LidarInertialOdometry<Map, Kernel>::bring_to_stated_time(PointCloud<float>& cloud, const SE3d& T_end_scan) {
  constexpr double lever = 20, negligible = 0.005;  // metres
  if (detail::moved_distance(T_end_scan.log(), lever) > negligible)
    cloud.positions = transformed(cloud.positions, T_end_scan).positions;
}

/// Decides what the next prediction may use.
template <class Map, class Kernel>
void LidarInertialOdometry<Map, Kernel>::watch_imu(const Attempt& attempt, const Eigen::Vector3d& scanned_at) {
  const ImuUse before = monitor_.use();
  const bool measured = motion_.measured_share() > 0;
  const Eigen::Vector3d velocity = state().template get<Inertial::velocity>().value();
  const Eigen::Vector3d way_off = scaled(scan_clock_.deviation(), velocity);
  detail::ImuComparison comparison = motion_.comparison();
  comparison.speed_deviation =
      std::sqrt(detail::AccelNoise::by_time_error(way_off.norm()) * velocity_variance(covariance()));
  monitor_.follow(measured ? motion_.use() : before, attempt.is_odd() ? detail::ImuComparison{} : comparison);
  if (attempt.match.degenerate_directions == 0) {
    scan_clock_.follow(comparison, scanned_at, velocity);
    motion_.learned_noise().follow(comparison, attempt.own_pose.translation(), way_off);
  } else {
    motion_.learned_noise().interrupt();
    scan_clock_.interrupt();
  }
  if (clock_was_to_blame()) return forget_imu(std::nullopt);
  if (monitor_.use() > before) motion_.forget_biases(monitor_.use());
  if (monitor_.back_to_all()) motion_.set_up(monitor_.up());
  if (before == ImuUse::none && monitor_.use() < before) motion_.doubt_mounting();
}

/// Whether the IMU is contradicted, and the times of scans turn out to be off by far more than was assumed.
template <class Map, class Kernel>
bool LidarInertialOdometry<Map, Kernel>::clock_was_to_blame() {
  const double deviation = scan_clock_.deviation();
  const bool contradicted = std::max(motion_.use(), monitor_.use()) > options_.imu_use && motion_.measured_share() > 0;
  if (!contradicted || deviation <= 2 * blamed_deviation_) return false;
  blamed_deviation_ = deviation;
  return true;
}

/// Uses all of the IMU again; what was learnt from it is forgotten.
template <class Map, class Kernel>
void LidarInertialOdometry<Map, Kernel>::forget_imu(const std::optional<Eigen::Vector3d>& up) {
  motion_.forget_biases(ImuUse::none);
  motion_.learned_noise().restart();
  if (up) motion_.set_up(S2d::from_vector(*up));
  monitor_ = detail::ImuMonitor(options_.monitor);
  motion_.doubt_mounting();
}

template <class Map, class Kernel>
void LidarInertialOdometry<Map, Kernel>::correct_imu(const ImuCorrection& correction,
                                                     const std::optional<Eigen::Vector3d>& up, double axes_deviation) {
  constexpr double clearly_late = 0.02, clearly_turned = 0.02, turned = 1e-6;  // seconds, radians
  const ImuCorrection change = correction.since(imu_correction());
  motion_.correct(correction);
  const double angle = change.R_body_imu.log().norm();
  const bool clear = std::abs(change.time_offset) >= clearly_late || angle >= clearly_turned;
  if (angle >= turned) motion_.set_axes_deviation(axes_deviation);
  if (!motion_.started() || (!clear && angle < turned)) return;
  motion_.hold_mounting();  // what the filter has learnt of it is in the correction
  clear ? forget_imu(up) : motion_.doubt_mounting();
}

template <class Map, class Kernel>
Frame LidarInertialOdometry<Map, Kernel>::lose(Attempt& attempt, double since_last) {
  attempt.filter = motion_.filter();
  ++counts_.lost_scans;
  health_ = {.update = attempt.report.status, .measured_share = motion_.measured_share()};
  doubt_.lose(since_last);
  motion_.learned_noise().interrupt();
  scan_clock_.interrupt();
  Frame frame = answer(attempt, FrameStatus::lost);
  if (++lost_in_a_row_ > options_.max_lost_scans) {
    ++counts_.map_restarts;
    map_.clear();
    map_.extend(attempt.clouds.map, T_odom_body(state()));
    doubt_.restart(frame.T_odom_body, frame.covariance);
    frame.health.map_restarted = true;
  }
  return frame;
}

template <class Map, class Kernel>
Frame LidarInertialOdometry<Map, Kernel>::answer(Attempt& attempt, FrameStatus status) const {
  Frame frame;
  frame.time = motion_.time();
  frame.T_odom_body = tilt_correction_.T_odom_map() * T_odom_body(state());
  const double times = options_.stated_deviations * options_.stated_deviations;
  frame.covariance = doubt_.in_odom(frame.T_odom_body, scaled(times, pose_covariance(state(), covariance())));
  frame.health = {.status = status,
                  .points = to_index(attempt.clouds.points.size()),
                  .matches = attempt.match.matches,
                  .residual_rms = attempt.match.residual_rms,
                  .iterations = attempt.match.iterations};
  if (motion_.interval() > 0 && !motion_.imu().samples().empty()) {  // else it is the first frame, or there is no IMU
    frame.health.imu_use = motion_.measured_share() > 0.5 ? motion_.use() : ImuUse::none;
    frame.health.imu_as_set = frame.health.imu_use == ImuUse::gyroscope && options_.imu_use == ImuUse::gyroscope;
  }
  if (motion_.use() == ImuUse::all && motion_.interval() > 0)
    frame.delta_velocity =
        detail::delta_velocity(motion_.imu(), frame.time - seconds(motion_.interval()), frame.time,
                               motion_.way_begin().rotation().local(T_odom_body(state()).rotation()));
  frame.cloud = std::move(attempt.clouds.whole);
  return frame;
}

#ifdef CHAINSLAM_COMPILED
extern template class LidarInertialOdometry<>;
extern template std::optional<Frame> LidarInertialOdometry<>::process(const Packet&, const Serial&);
extern template std::optional<Frame> LidarInertialOdometry<>::process(const Packet&, const ThreadPool&);
extern template std::optional<Frame> LidarInertialOdometry<>::flush(const Serial&);
extern template std::optional<Frame> LidarInertialOdometry<>::flush(const ThreadPool&);
#endif

}  // namespace chainslam
