#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "chainslam/sensor/packet.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "simulator/gnss_receiver.hpp"
#include "simulator/inertial_unit.hpp"
#include "simulator/pose_spline.hpp"
#include "simulator/ray_caster.hpp"
#include "simulator/roadside.hpp"
#include "simulator/spinning_lidar.hpp"

namespace chainslam::simulator {

/// What a semi-real drive is made with, beside its trajectory and its IMU data.
struct RecordedDriveOptions {
  /// The LiDAR of a car, as it comes calibrated: elevations off by as much as KITTI's are known to be (0.2 degrees), so
  /// that LiDAR odometry drifts by about 0.5 % as it does there. With a quarter of that error it drifts by 0.15 %.
  LidarOptions lidar{.kind = LidarKind::hdl_64e,
                     .T_body_lidar = {},
                     .firings_per_revolution = 2082,
                     .max_range = 100.0,
                     .range_noise = 0.02,
                     .lost_returns = 0.02,
                     .elevation_error_deg = 0.2,
                     .range_bias = 0.03,
                     .mount_angle_deg = 0.2,
                     .mount_shift = 0.02,
                     .beam_width_deg = 0.16};
  double lidar_height = 1.73;  ///< of the LiDAR above the road, metres; KITTI's
  InertialOptions imu{};       ///< of the IMU that is simulated where none was recorded
  GroundOptions ground{};
  RoadsideOptions roadside{};
  std::optional<GnssOptions> gnss{};  ///< of a receiver at the body's origin that is simulated, if any
  std::uint64_t seed = 1;
};

/// How well recorded IMU data suit a motion.
struct ImuAgreement {
  double lag = 0.0;           ///< the samples are stamped this much too late, by the rates, seconds; within +-0.25
  double gyro_rms = 0.0;      ///< of rates minus the motion's at that lag, norm, rad/s
  double gyro_signal = 0.0;   ///< of the rates themselves, rad/s
  double accel_rms = 0.0;     ///< of specific forces minus the motion's, norm, m/s^2
  double accel_signal = 0.0;  ///< of specific forces minus gravity in a level body, m/s^2
};

/// Compares samples with what an ideal IMU would measure on the motion, which starts at `epoch`.
[[nodiscard]] ImuAgreement compare(const VehicleMotion& motion, std::span<const ImuSample> imu, Timestamp epoch);

/// A drive on a real trajectory: simulated scans of a world that is built along it, and the IMU data that were recorded
/// on it, unchanged, as a stream of packets in time order.
///
/// Several drives on trajectories of one frame can share a world, which is built along all of them; their map frame is
/// then made, as follows, from the one that began first.
///
/// The map frame is the trajectory's, moved to start at zero and turned by the least angle that makes it level: so that
/// the recorded specific forces, turned into it, have their mean along z, or without them the body's z axes. The truth
/// is the spline through the poses, not the poses.
class RecordedDrive {
 public:
  /// @param trajectory  T_map_body; see `PoseSpline`.
  /// @param imu  samples on the trajectory's clock, increasing; if empty they are simulated.
  /// @param others  the other drives through the same world; the world does not depend on which of them this is.
  /// @throws std::invalid_argument if a trajectory is too short, spreads too far, or its body does not stay upright;
  /// or if the specific forces, turned into its frame, have no mean of about one g.
  RecordedDrive(const Trajectory& trajectory, std::vector<ImuSample> imu, const RecordedDriveOptions& options,
                std::span<const Trajectory> others = {});

  /// The next packet: IMU samples, fixes, and scans at their end; nothing after the last of them. At equal times scans
  /// come last.
  [[nodiscard]] std::optional<Packet> next();

  [[nodiscard]] Timestamp epoch() const { return epoch_; }
  [[nodiscard]] Timestamp end() const { return epoch_ + seconds(motion_.duration()); }
  [[nodiscard]] Index scan_count() const { return scan_count_; }
  /// When the last laser of a scan has fired.
  [[nodiscard]] Timestamp scan_end(Index index) const {
    return epoch_ + index * lidar_.period() + lidar_.last_return();
  }
  /// Scan `index` as the sensor reports it, and as the library's record. Safe from several threads.
  [[nodiscard]] Revolution revolution(Index index) const { return lidar_.turn(caster_, motion_, index); }
  [[nodiscard]] LidarScan scan(Index index) const { return lidar_.to_scan(revolution(index), epoch_); }
  /// The truth, T_map_body, at every scan's end.
  [[nodiscard]] Trajectory truth_at_scan_ends() const;

  /// Metres of the path that lie more than `limit` above or below the ground: where passes at different heights share
  /// one place, as at bridges, the ground lies between them.
  [[nodiscard]] double off_ground(double limit) const;

  [[nodiscard]] double length() const { return length_; }  ///< of this drive, metres
  [[nodiscard]] const PoseSpline& motion() const { return motion_; }
  [[nodiscard]] const DrivenPath& path() const { return path_; }
  [[nodiscard]] const RayCaster& caster() const { return caster_; }
  [[nodiscard]] const SpinningLidar& lidar() const { return lidar_; }
  [[nodiscard]] const std::vector<ImuSample>& imu() const { return imu_; }
  [[nodiscard]] const std::vector<GnssReading>& gnss() const { return gnss_; }
  [[nodiscard]] const RecordedDriveOptions& options() const { return options_; }

 private:
  RecordedDrive(const Trajectory& trajectory, std::vector<ImuSample> imu, const RecordedDriveOptions& options,
                std::span<const Trajectory> others, const SE3d& T_map_trajectory);

  RecordedDriveOptions options_;
  Timestamp epoch_;
  PoseSpline motion_;
  DrivenPath path_;  ///< of all drives
  double length_;
  RayCaster caster_;
  SpinningLidar lidar_;
  std::vector<ImuSample> imu_;
  std::vector<GnssReading> gnss_;
  Index scan_count_;
  std::size_t next_imu_ = 0;
  std::size_t next_gnss_ = 0;
  Index next_scan_ = 0;
};

}  // namespace chainslam::simulator
