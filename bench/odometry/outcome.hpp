#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <tuple>

#include "chainslam/odometry/lidar_inertial_odometry.hpp"
#include "chainslam/odometry/lidar_odometry.hpp"
#include "chainslam/odometry/self_calibrating.hpp"
#include "chainslam/search/ikd_tree.hpp"
#include "chainslam/trajectory/kitti_errors.hpp"
#include "support/drive_run.hpp"

namespace chainslam::bench {

/// The odometries that `odometry.source` chooses from, with the settings that users get.
/// @{
struct LidarSource {
  using Odometry = LidarOdometry<>;
  static Odometry::Options options() { return {}; }
};
struct FastLio2Source {
  using Odometry = LidarInertialOdometry<IkdTree<float, NearestToCenter>, Trivial>;
  static Odometry::Options options() { return fast_lio2_options(); }
};
struct LidarInertialSource {
  using Odometry = SelfCalibrating<LidarInertialOdometry<>>;
  static Odometry::Options options() { return {}; }
};
/// @}

/// What an odometry came to on a drive; what is not known stays empty.
struct Outcome {
  std::optional<double> ape{};    ///< metres, rms, aligned by a rotation and a translation
  std::optional<double> kitti{};  ///< percent
  double path = 0;                ///< metres, steps below 0.05 m left out, in which noise would add up at a stop
  std::int64_t lost = 0;          ///< scans lost, or without a frame
  double milliseconds = 0;        ///< per scan
  bool finite = true;             ///< every pose
};

[[nodiscard]] inline double travelled(const Trajectory& trajectory) {
  double length = 0;
  if (trajectory.empty()) return length;
  Eigen::Vector3d last = trajectory.poses.front().translation();
  for (const SE3d& pose : trajectory.poses) {
    const double step = (pose.translation() - last).norm();
    if (step < 0.05) continue;
    length += step;
    last = pose.translation();
  }
  return length;
}

/// @param drive  its reference, where there is one.
[[nodiscard]] inline Outcome outcome_of(const test::Drive& drive, const test::DriveRun& run) {
  const LidarOdometryCounts& counts = run.counts;
  Outcome outcome{.path = travelled(run.lidar),
                  .lost = counts.lost_scans + counts.scans - counts.frames,
                  .milliseconds = 1e3 * run.seconds_per_scan,
                  .finite = !first_not_finite(run.lidar.poses)};
  if (!outcome.finite || drive.reference.empty()) return outcome;
  const MatchedTrajectories poses = test::counted_poses(drive, run.lidar);
  const AbsolutePoseErrors absolute = ape(poses.reference, poses.estimate);
  if (absolute.status == EvaluationStatus::evaluated) outcome.ape = absolute.translation.rmse;
  const KittiErrors relative = kitti_errors(poses.reference, poses.estimate);
  if (relative.status == EvaluationStatus::evaluated) outcome.kitti = 100 * relative.translation;
  return outcome;
}

/// One of the odometries on its way along a drive.
template <class Source>
class Contender {
 public:
  explicit Contender(const SE3d& T_body_lidar) : odometry_(options(T_body_lidar)), run_(odometry_, T_body_lidar) {}
  Contender(const Contender&) = delete;
  Contender& operator=(const Contender&) = delete;

  void feed(const Packet& packet) { run_.feed(packet); }
  [[nodiscard]] Outcome finish(const test::Drive& drive) { return outcome_of(drive, run_.finish()); }

 private:
  static typename Source::Odometry::Options options(const SE3d& T_body_lidar) {
    auto options = Source::options();
    options.T_body_lidar = T_body_lidar;
    return options;
  }

  typename Source::Odometry odometry_;
  test::OdometryRun<typename Source::Odometry> run_;
};

/// Runs odometries side by side, so that scans which take long to read or to simulate are there once.
/// @param drive  its reference, where there is one, and where the LiDAR sits; not its scans.
/// @param next_packet  yields `std::optional<Packet>`, nothing after the last one.
template <class... Sources, class NextPacket>
[[nodiscard]] std::array<Outcome, sizeof...(Sources)> outcomes_of(const test::Drive& drive, NextPacket&& next_packet) {
  std::tuple<Contender<Sources>...> contenders{((void)sizeof(Sources), drive.T_body_lidar)...};
  while (const std::optional<Packet> packet = next_packet())
    std::apply([&](auto&... all) { (all.feed(*packet), ...); }, contenders);
  return std::apply([&](auto&... all) { return std::array{all.finish(drive)...}; }, contenders);
}

}  // namespace chainslam::bench
