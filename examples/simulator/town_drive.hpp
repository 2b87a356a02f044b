#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "chainslam/sensor/packet.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "simulator/preset.hpp"
#include "simulator/ray_caster.hpp"

namespace chainslam::simulator {

/// A simulated session: one vehicle, its sensors and the truth, as a stream of packets in time order.
///
/// The same preset, seed and number give the same session. Sessions of one preset and seed share the town, its map
/// frame and the vehicle. Frames: `body` is the inertial unit, `lidar` the sensor's own, both
/// z up; `nominal_T_body_lidar()` is what an estimator should assume. The map frame is the world's: x north, y west, z
/// up.
class TownDrive {
 public:
  /// @throws std::out_of_range if the preset has no session of this number, counted from 0.
  TownDrive(const Preset& preset, std::uint64_t seed, std::size_t session = 0);

  /// The next packet: inertial samples, GNSS fixes (none in outages) and the scans that arrive, at their end; nothing
  /// after the drive.
  /// At equal times inertial samples come first and scans last.
  [[nodiscard]] std::optional<Packet> next();

  /// When the drive starts: 12:00 UTC of its day; day 0 is 2013-06-01.
  [[nodiscard]] Timestamp epoch() const { return epoch_; }
  [[nodiscard]] Timestamp end() const { return epoch() + seconds(drive_.duration()); }
  [[nodiscard]] Index scan_count() const { return scan_count_; }
  /// When the last laser of a scan has fired.
  [[nodiscard]] Timestamp scan_end(Index index) const {
    return epoch() + index * lidar_.period() + lidar_.last_return();
  }

  /// Scan `index` as the sensor reports it, and as the library's record. Safe from several threads.
  [[nodiscard]] Revolution revolution(Index index) const;
  [[nodiscard]] LidarScan scan(Index index) const { return lidar_.to_scan(revolution(index), epoch()); }

  /// The truth, T_map_body, at any time of the drive.
  [[nodiscard]] SE3d truth(Timestamp time) const { return drive_.pose(to_seconds(time - epoch())); }
  /// ... at every scan's end, ...
  [[nodiscard]] Trajectory truth_at_scan_ends() const;
  /// ... and at every inertial sample.
  [[nodiscard]] Trajectory truth_at_imu_rate() const;

  [[nodiscard]] const Drive& drive() const { return drive_; }
  [[nodiscard]] const RayCaster& caster() const { return caster_; }
  [[nodiscard]] const Traffic& traffic() const { return traffic_; }
  [[nodiscard]] const SpinningLidar& lidar() const { return lidar_; }
  [[nodiscard]] const std::vector<ImuSample>& imu() const { return imu_; }
  [[nodiscard]] const std::vector<GnssReading>& gnss() const { return gnss_; }

 private:
  TownDrive(const Preset& preset, const SessionPlan& session, const Rng& rng, Town town);

  Timestamp epoch_;
  Drive drive_;
  Terrain terrain_;
  RayCaster caster_;
  Traffic traffic_;
  SpinningLidar lidar_;
  std::vector<ImuSample> imu_;
  std::vector<GnssReading> gnss_;
  Index scan_count_;
  std::size_t next_imu_ = 0;
  std::size_t next_gnss_ = 0;
  Index next_scan_ = 0;
};

}  // namespace chainslam::simulator
