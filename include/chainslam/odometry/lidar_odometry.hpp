#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <optional>
#include <type_traits>
#include <utility>
#include <variant>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/compiled.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/odometry/deskew.hpp"
#include "chainslam/odometry/detail/moved_distance.hpp"
#include "chainslam/odometry/detail/pose_doubt.hpp"
#include "chainslam/odometry/detail/translation_search.hpp"
#include "chainslam/odometry/imu_process.hpp"
#include "chainslam/odometry/motion_predictor.hpp"
#include "chainslam/odometry/odometry_source.hpp"
#include "chainslam/odometry/scan_to_map.hpp"
#include "chainslam/search/voxel_map.hpp"
#include "chainslam/sensor/frame.hpp"
#include "chainslam/sensor/imu_check.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam {

/// Settings of `LidarOdometry`; the defaults serve spinning LiDARs of 16 to 128 rings on cars and robots.
///
/// @tparam Downsampling  how the local map downsamples its input, such as `NearestToCenter`.
template <class Kernel = GemanMcClure, class Downsampling = VoxelMapOptions>
struct LidarOdometryOptions {
  SE3d T_body_lidar;         ///< extrinsic calibration; body = the IMU, or the LiDAR itself if there is none
  ScanFilter filter{};       ///< which points of a scan are used
  double map_voxel = 0.5;    ///< metres; points of a scan offered to the map
  double scan_voxel = 0.75;  ///< metres; points of a scan given to registration
  Downsampling map = detail::half_metre_apart<Downsampling>();  ///< how the local map downsamples
  double map_radius = 150;           ///< metres around the body; farther points leave the local map
  Index min_points = 50;             ///< after the voxel filter; scans with fewer count as empty
  double min_match_ratio = 0.2;      ///< of the points given to registration; with less the scan is lost
  double redeskew_distance = 0.06;   ///< metres of skew left after registration that call for a second pass
  Index max_lost_scans = 10;         ///< in a row; then the local map is reset at the estimated position
  ImuCheckOptions imu_check{};       ///< which IMU samples are rejected
  ImuInitializer imu_initializer{};  ///< gravity and gyroscope bias at the start
  MotionPredictorOptions motion{};   ///< prediction of the motion
  ScanToMap<Kernel> scan_to_map{};   ///< registration
};

/// LiDAR odometry: each scan is registered to a local map of the scans before it. A gyroscope, where there is one,
/// predicts the rotation and corrects the sweep; without one the motion of the scan before is continued.
///
/// The first pose is the origin of `odom`; with an IMU its +z is up. The body may move from the first scan on, by up to
/// 45 m/s: the second scan shows the velocity, and all poses are correct when they are returned. Only the cloud of the
/// first frame, returned before that, is undistorted by the gyroscope alone. Scans without an answer leave defined
/// traces:
/// - too few points, or a time not later than the last frame's: no frame, counted;
/// - too few matches or an implausible pose: a frame with status `lost` at the predicted pose, with a covariance that
///   grows with the time without a match; its points do not enter the map;
/// - more than `max_lost_scans` lost in a row: the local map is restarted at the predicted pose, whose covariance all
///   later frames carry.
/// Deterministic: bit-identical for any executor. Poses are always finite.
///
/// @tparam Map  a growing map that downsamples itself, made from its `downsampling()`: `VoxelMap`, `IkdTree`. One point
/// a
///              voxel is lighter and drifts less in streets, but a wall in the very faces of the voxels leaves two
///              layers of points, of which planes are poor; points at a spacing know no faces.
template <class Map = VoxelMap<float>, class Kernel = GemanMcClure>
class LidarOdometry {
  static_assert(
      IncrementalSearch<Map>,
      "LidarOdometry: Map needs what grows, forgets and finds, as in VoxelMap; see chainslam/search/concepts.hpp");

 public:
  /// Its settings.
  using Options =
      LidarOdometryOptions<Kernel, std::remove_cvref_t<decltype(std::declval<const Map&>().downsampling())>>;

  /// Starts without a map.
  explicit LidarOdometry(Options options = {})
      : options_(std::move(options)), map_(options_.map), imu_check_(options_.imu_check), motion_(options_.motion) {}

  /// Takes the next packet, in time order. @returns a frame, at the end of the scan, if the packet was a usable scan.
  /// @throws std::invalid_argument if a scan's columns do not match.
  template <Executor E = Serial>
  std::optional<Frame> process(const Packet& packet, const E& executor = {});

  /// What became of scans, points and IMU samples so far.
  [[nodiscard]] const LidarOdometryCounts& counts() const { return counts_; }
  /// What was known of the IMU at the first scan.
  [[nodiscard]] const ImuStart& imu_start() const { return imu_start_; }
  [[nodiscard]] const Eigen::Vector3d& gyro_bias() const { return motion_.gyro_bias(); }  ///< rad/s
  [[nodiscard]] const Map& local_map() const { return map_; }                             ///< odom frame

 private:
  struct Registered {
    PointCloud<float> cloud;             ///< body frame at the scan's end
    PointCloud<float> map_points;        ///< for the map
    PointCloud<float> points;            ///< for registration
    Vector6d twist = zeros<Vector6d>();  ///< that corrected it
    ScanMatch match;
  };
  struct Sweep {
    Timestamp begin, end;
    PointCloud<float> points;  ///< usable ones, lidar frame
  };

  [[nodiscard]] bool in_order(const LidarScan& scan) const;
  template <Executor E>
  [[nodiscard]] std::optional<Frame> start(Sweep sweep, const E& executor);
  template <Executor E>
  [[nodiscard]] Registered corrected(const Sweep& sweep, const Vector6d& twist, const E& executor) const;
  template <Executor E>
  [[nodiscard]] Registered registered(const Sweep& sweep, const MotionPrediction& prediction, const SE3d& guess,
                                      double error, const E& executor) const;
  template <Executor E>
  [[nodiscard]] Registered registered(const Sweep& sweep, const MotionPrediction& prediction, const E& executor) const;
  template <Executor E>
  void rebuild_map(const Sweep& first, const Vector6d& twist, const E& executor);
  [[nodiscard]] Frame answer(Registered& scan, FrameStatus status) const;
  [[nodiscard]] bool empty(const Registered& scan) const { return to_index(scan.points.size()) < options_.min_points; }
  [[nodiscard]] bool believable(const Registered& scan, const MotionPrediction& prediction) const;
  [[nodiscard]] Frame follow(Registered scan, const MotionPrediction& prediction);
  [[nodiscard]] Frame lose(Registered scan, const MotionPrediction& prediction);
  [[nodiscard]] double skew_left(const Sweep& sweep, const Vector6d& twist_change) const;
  void extend_map(const PointCloud<float>& points);

  Options options_;
  LidarOdometryCounts counts_;
  Map map_;
  ImuCheck imu_check_;
  MotionPredictor motion_;
  ImuStart imu_start_;
  std::optional<Sweep> first_;  ///< the first scan, until the motion during it is known
  detail::PoseDoubt doubt_;
  bool started_ = false;
  Index lost_in_a_row_ = 0;
  Eigen::Vector3d map_center_ = Eigen::Vector3d::Zero();  ///< where the map was last cut to its radius
};

template <class Map, class Kernel>
template <Executor E>
std::optional<Frame> LidarOdometry<Map, Kernel>::process(const Packet& packet, const E& executor) {
  if (const auto* sample = std::get_if<ImuSample>(&packet)) {
    imu_check_.add(*sample, [&](const ImuSample& checked) {
      if (checked.rate_measured) motion_.add(checked);
    });
    counts_.imu = imu_check_.counts();
  }
  const auto* scan = std::get_if<LidarScan>(&packet);
  if (scan == nullptr) return std::nullopt;
  ++counts_.scans;
  if (!in_order(*scan)) {
    ++counts_.out_of_order_scans;
    return std::nullopt;
  }
  Sweep sweep{scan->time, scan->end, options_.filter.apply(scan->cloud, counts_.points)};
  if (!started_) return start(std::move(sweep), executor);

  MotionPrediction prediction = motion_.predict(sweep.begin, sweep.end);
  Registered result = registered(sweep, prediction, executor);
  if (empty(result)) {
    ++counts_.empty_scans;
    return std::nullopt;
  }
  if (!believable(result, prediction) && prediction.error < options_.motion.initial_error) {
    prediction.error = options_.motion.initial_error;  // once more, as if nothing were known of the motion
    result = registered(sweep, prediction, executor);
  }
  if (first_ && believable(result, prediction)) {
    prediction.twist = motion_.found_twist(prediction, result.twist, result.match.T_map_body);
    prediction.T_odom_body = motion_.T_odom_body().retract(prediction.since_last * prediction.twist);
    motion_.correct_start(prediction.twist);
    rebuild_map(*std::exchange(first_, std::nullopt), prediction.twist, executor);
    result = registered(sweep, prediction, executor);
  }
  first_.reset();
  ++counts_.frames;
  if (prediction.since_last > options_.motion.max_gap) ++counts_.gaps;
  if (prediction.with_gyro) ++counts_.gyro_scans;
  return believable(result, prediction) ? follow(std::move(result), prediction) : lose(std::move(result), prediction);
}

template <class Map, class Kernel>
bool LidarOdometry<Map, Kernel>::in_order(const LidarScan& scan) const {
  return scan.time <= scan.end && (!started_ || motion_.comes_after(scan.time, scan.end));
}

template <class Map, class Kernel>
template <Executor E>
std::optional<Frame> LidarOdometry<Map, Kernel>::start(Sweep sweep, const E& executor) {
  Registered scan = corrected(sweep, zeros<Vector6d>(), executor);
  if (empty(scan)) {
    ++counts_.empty_scans;
    return std::nullopt;
  }
  ++counts_.frames;
  imu_start_ = motion_.start(sweep.begin, sweep.end, options_.imu_initializer);
  started_ = true;
  extend_map(scan.map_points);
  if (sweep.points.has_times()) first_ = std::move(sweep);
  Frame frame;
  frame.time = motion_.time();
  frame.T_odom_body = motion_.T_odom_body();
  frame.covariance = detail::anchored_covariance();
  frame.health.points = to_index(scan.points.size());
  frame.cloud = std::move(scan.cloud);
  return frame;
}

/// The sweep's points, undistorted by a constant twist; those for the map and for registration by their positions
/// alone.
template <class Map, class Kernel>
template <Executor E>
auto LidarOdometry<Map, Kernel>::corrected(const Sweep& sweep, const Vector6d& twist, const E& executor) const
    -> Registered {
  Registered scan;
  scan.twist = twist;
  const SweepMotion motion = motion_.sweep_motion(sweep.begin, sweep.end, twist);
  scan.cloud = deskew(sweep.points, motion, options_.T_body_lidar, executor);
  scan.map_points = voxel_downsample(scan.cloud.positions, options_.map_voxel);
  scan.points = voxel_downsample(scan.map_points.positions, options_.scan_voxel);
  return scan;
}

template <class Map, class Kernel>
void LidarOdometry<Map, Kernel>::extend_map(const PointCloud<float>& points) {
  map_.insert(transformed(points, motion_.T_odom_body()));
  const Eigen::Vector3d& center = motion_.T_odom_body().translation();
  if ((center - map_center_).norm() < 0.1 * options_.map_radius) return;
  map_.erase_farther_than(center.cast<float>(), static_cast<float>(options_.map_radius));
  map_center_ = center;
}

/// Corrects the sweep by the predicted motion, registers it from a guess of its pose, and once more by the motion found
/// if that differs enough.
template <class Map, class Kernel>
template <Executor E>
auto LidarOdometry<Map, Kernel>::registered(const Sweep& sweep, const MotionPrediction& prediction, const SE3d& guess,
                                            double error, const E& executor) const -> Registered {
  Registered scan = corrected(sweep, prediction.twist, executor);
  if (empty(scan)) return scan;
  scan.match = options_.scan_to_map.align(scan.points, map_, guess, error, executor);
  const bool skewed_map = first_.has_value();  // corrected as little as this sweep so far: to be mended together
  if (scan.match.status == ScanMatchStatus::too_few_matches || !sweep.points.has_times() || skewed_map) return scan;
  const Vector6d twist = motion_.found_twist(prediction, scan.twist, scan.match.T_map_body);
  if (skew_left(sweep, twist - prediction.twist) < options_.redeskew_distance) return scan;
  const ScanMatch before = scan.match;
  scan = corrected(sweep, twist, executor);
  scan.match = options_.scan_to_map.align(scan.points, map_, before.T_map_body, options_.motion.min_error, executor);
  scan.match.iterations += before.iterations;
  return scan;
}

/// Registers the sweep from the predicted pose and, where nothing is known of the motion and that is not clearly right,
/// from other places that look alike: the most weight of matches decides.
template <class Map, class Kernel>
template <Executor E>
auto LidarOdometry<Map, Kernel>::registered(const Sweep& sweep, const MotionPrediction& prediction,
                                            const E& executor) const -> Registered {
  Registered best = registered(sweep, prediction, prediction.T_odom_body, prediction.error, executor);
  if (prediction.error < options_.motion.initial_error || empty(best) ||
      detail::TranslationSearch::needless(best.match.weight, best.points.size()))
    return best;
  const detail::TranslationSearch search = detail::TranslationSearch::after(prediction.since_last);
  const detail::PlaneRule plane = options_.scan_to_map.plane_rule(search.spacing);
  for (const SE3d& T :
       search(best.points, map_, plane, best.match.T_map_body, prediction.T_odom_body.translation(), executor)) {
    Registered other = registered(sweep, prediction, T, search.spacing, executor);
    if (believable(other, prediction) && (!believable(best, prediction) || other.match.weight > best.match.weight))
      best = std::move(other);
  }
  return best;
}

/// Corrects the first scan by the motion that the second has shown, and builds the map from it again.
template <class Map, class Kernel>
template <Executor E>
void LidarOdometry<Map, Kernel>::rebuild_map(const Sweep& first, const Vector6d& twist, const E& executor) {
  map_ = Map(options_.map);
  extend_map(corrected(first, twist, executor).map_points);
}

/// How far a change of the twist moves the sweep's first points against its last, metres.
template <class Map, class Kernel>
double LidarOdometry<Map, Kernel>::skew_left(const Sweep& sweep, const Vector6d& twist_change) const {
  constexpr double lever = 20;  // metres
  return to_seconds(sweep.end - sweep.begin) * detail::moved_distance(twist_change, lever);
}

template <class Map, class Kernel>
bool LidarOdometry<Map, Kernel>::believable(const Registered& scan, const MotionPrediction& prediction) const {
  return scan.match.status != ScanMatchStatus::too_few_matches &&
         scan.match.matches >= options_.min_match_ratio * static_cast<double>(scan.points.size()) &&
         MotionPredictor::deviation(prediction, scan.match.T_map_body) <= 2 * options_.motion.initial_error;
}

template <class Map, class Kernel>
Frame LidarOdometry<Map, Kernel>::follow(Registered scan, const MotionPrediction& prediction) {
  const Vector6d skew = motion_.end_deviation(prediction, scan.twist, scan.match.T_map_body);
  if (!motion_.moving() && counts_.map_restarts == 0)
    doubt_.restart(motion_.T_odom_body(), MotionPredictor::start_covariance(prediction));
  motion_.follow(prediction, scan.twist, scan.match.T_map_body);
  doubt_.match();
  lost_in_a_row_ = 0;
  extend_map(scan.map_points);
  Frame frame = answer(scan, scan.match.degenerate_directions > 0 ? FrameStatus::degenerate : FrameStatus::good);
  if (frame.health.status == FrameStatus::degenerate) ++counts_.degenerate_scans;
  Matrix6d covariance = scan.match.covariance;
  for (int i = 0; i < 6; ++i) covariance(i, i) += skew[i] * skew[i];
  frame.covariance = doubt_.in_odom(frame.T_odom_body, covariance);
  frame.health.after_gap = prediction.since_last > options_.motion.max_gap;
  return frame;
}

template <class Map, class Kernel>
Frame LidarOdometry<Map, Kernel>::lose(Registered scan, const MotionPrediction& prediction) {
  motion_.lose(prediction);
  doubt_.lose(prediction.since_last);
  ++counts_.lost_scans;
  Frame frame = answer(scan, FrameStatus::lost);
  Matrix6d predicted = zeros<Matrix6d>();
  for (int i = 0; i < 3; ++i) predicted(i, i) = prediction.error * prediction.error;
  frame.covariance = doubt_.in_odom(frame.T_odom_body, predicted);
  frame.health.after_gap = prediction.since_last > options_.motion.max_gap;
  if (++lost_in_a_row_ > options_.max_lost_scans) {
    ++counts_.map_restarts;
    map_ = Map(options_.map);
    extend_map(scan.map_points);
    doubt_.restart(frame.T_odom_body, frame.covariance);
    frame.health.map_restarted = true;
  }
  return frame;
}

template <class Map, class Kernel>
Frame LidarOdometry<Map, Kernel>::answer(Registered& scan, FrameStatus status) const {
  Frame frame;
  frame.time = motion_.time();
  frame.T_odom_body = motion_.T_odom_body();
  frame.health = {.status = status,
                  .points = to_index(scan.points.size()),
                  .matches = scan.match.matches,
                  .residual_rms = scan.match.residual_rms,
                  .iterations = scan.match.iterations};
  frame.cloud = std::move(scan.cloud);
  return frame;
}

#ifdef CHAINSLAM_COMPILED
extern template class LidarOdometry<>;
extern template std::optional<Frame> LidarOdometry<>::process(const Packet&, const Serial&);
extern template std::optional<Frame> LidarOdometry<>::process(const Packet&, const ThreadPool&);
#endif

}  // namespace chainslam
