#pragma once

#include <algorithm>
#include <cstddef>
#include <ctime>
#include <optional>
#include <utility>
#include <variant>
#include <vector>

#include "chainslam/odometry/odometry_source.hpp"
#include "chainslam/sensor/frame.hpp"
#include "chainslam/sensor/packet.hpp"
#include "chainslam/trajectory/association.hpp"
#include "chainslam/trajectory/pose_errors.hpp"
#include "support/real_drives.hpp"

namespace chainslam::test {

/// What an odometry made of a drive.
struct DriveRun {
  Trajectory lidar;                 ///< T_odom_lidar at the frames' times
  std::vector<FrameRecord> frames;  ///< as a map keeps them
  LidarOdometryCounts counts;
  double seconds_per_scan = 0;  ///< processor time of the thread, IMU measurements included
};

namespace internal {

/// Processor time of this thread, seconds: other programs do not count.
inline double thread_seconds() {
  std::timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

}  // namespace internal

/// An odometry while it is fed, and what it has made of the packets so far.
template <class Odometry>
class OdometryRun {
 public:
  OdometryRun(Odometry& odometry, const SE3d& T_body_lidar) : odometry_(odometry), T_body_lidar_(T_body_lidar) {}

  void feed(const Packet& packet) {
    scans_ += std::holds_alternative<LidarScan>(packet);
    take([&] { return odometry_.process(packet); });
  }

  /// After the last packet.
  [[nodiscard]] DriveRun finish() {
    if constexpr (requires { odometry_.flush(); })
      while (take([&] { return odometry_.flush(); })) {
      }
    run_.counts = odometry_.counts();
    run_.seconds_per_scan = spent_ / static_cast<double>(std::max<std::size_t>(scans_, 1));
    return std::move(run_);
  }

 private:
  template <class Work>
  bool take(const Work& work) {
    const double begin = internal::thread_seconds();
    const std::optional<Frame> frame = work();
    spent_ += internal::thread_seconds() - begin;
    if (!frame) return false;
    run_.lidar.times.push_back(frame->time);
    run_.lidar.poses.push_back(frame->T_odom_body * T_body_lidar_);
    run_.frames.push_back(record_of(*frame));
    return true;
  }

  Odometry& odometry_;
  SE3d T_body_lidar_;
  DriveRun run_;
  double spent_ = 0;
  std::size_t scans_ = 0;
};

/// Feeds an odometry.
/// @param next_packet  yields `std::optional<Packet>`, nothing after the last one.
template <class Odometry, class NextPacket>
DriveRun run_packets(NextPacket&& next_packet, Odometry& odometry, const SE3d& T_body_lidar) {
  OdometryRun<Odometry> run(odometry, T_body_lidar);
  while (const std::optional<Packet> packet = next_packet()) run.feed(*packet);
  return run.finish();
}
template <class Odometry, class NextPacket>
DriveRun run_packets(NextPacket&& next_packet, const typename Odometry::Options& options) {
  Odometry odometry(options);
  return run_packets(std::forward<NextPacket>(next_packet), odometry, options.T_body_lidar);
}

/// The packets of a drive in time order, an IMU measurement before a scan that ends at its time; nothing after the last
/// scan. The drive has to outlive it.
inline auto packets_of(const Drive& drive) {
  return [&drive, scan = drive.scans.begin(), sample = drive.imu.begin()]() mutable -> std::optional<Packet> {
    if (scan == drive.scans.end()) return std::nullopt;
    if (sample != drive.imu.end() && sample->time <= scan->end) return Packet(*sample++);
    return Packet(*scan++);
  };
}

/// Feeds a drive to an odometry.
/// @param T_body_lidar  of the odometry's settings; the drive's own does not count.
template <class Odometry>
DriveRun run_drive(const Drive& drive, Odometry& odometry, const SE3d& T_body_lidar) {
  return run_packets(packets_of(drive), odometry, T_body_lidar);
}
template <class Odometry>
DriveRun run_drive(const Drive& drive, const typename Odometry::Options& options) {
  Odometry odometry(options);
  return run_drive(drive, odometry, options.T_body_lidar);
}

/// Frames with the reference at their times, without those that do not count.
inline MatchedTrajectories counted_poses(const Drive& drive, const Trajectory& lidar) {
  Trajectory counted;
  for (std::size_t i = 0; i < lidar.size(); ++i) {
    const auto leaves_out = [&](const TimeSpan& span) { return span.contains(lidar.times[i]); };
    if (std::ranges::any_of(drive.not_counted, leaves_out)) continue;
    counted.times.push_back(lidar.times[i]);
    counted.poses.push_back(lidar.poses[i]);
  }
  return match_interpolated(drive.reference, counted, seconds(1)).trajectories;
}

/// APE of the LiDAR's positions after alignment by a rotation and a translation.
inline AbsolutePoseErrors drive_ape(const Drive& drive, const Trajectory& lidar) {
  const MatchedTrajectories poses = counted_poses(drive, lidar);
  return ape(poses.reference, poses.estimate);
}

}  // namespace chainslam::test
