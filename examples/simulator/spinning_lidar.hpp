#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/sensor/lidar_scan.hpp"
#include "simulator/drive.hpp"
#include "simulator/ray_caster.hpp"

namespace chainslam::simulator {

/// A spinning LiDAR in the manner of Velodyne's HDL-32E, and how far it is from its data sheet.
struct LidarOptions {
  Index firings_per_revolution = 600;  ///< a multiple of 12; the real one makes 2170
  double period = 0.1;                 ///< seconds per revolution
  double max_range = 100.0;            ///< metres
  double min_range = 1.0;              ///< metres
  double range_noise = 0.015;          ///< standard deviation, metres
  double lost_returns = 0.005;         ///< lost whatever the surface, as a part of all
  double elevation_error_deg = 0.1;    ///< each laser is off by 0.2 to 1 times this, either way
  double range_bias = 0.02;            ///< each laser is off by 0.5 to 1.5 times this, either way, metres
  double incidence_bias = 0.003;       ///< range grows by this times (1 / cos(incidence) - 1), at most 10 times, metres
  double mount_angle_deg = 0.3;        ///< the true mounting is turned by this about a random axis
  double mount_shift = 0.02;           ///< ... and shifted by this in a random direction, metres
};

/// One return, as the sensor reports it: with its nominal angles.
struct LidarReturn {
  Eigen::Vector3f position;  ///< lidar frame (z up), metres
  std::uint16_t firing;      ///< within the revolution
  std::uint8_t laser;        ///< in the order of firing
  std::uint8_t intensity;
};

/// One revolution; returns in the order of firing, those that were lost left out.
struct Revolution {
  Duration start;  ///< of the first firing, since the drive's start
  std::vector<LidarReturn> returns;
};

/// Turns with the drive: the revolution's firings each have their own time and pose, so that motion skews the scan.
///
/// Azimuth runs from +180 down to -180 degrees in the lidar frame (the sensor turns clockwise, seen from above), half a
/// firing's step off at both ends: a revolution ends where a reader that cuts at the wrap of atan2 cuts it.
class SpinningLidar {
 public:
  static constexpr Index lasers = 32;
  static constexpr Index firings_per_packet = 12;

  /// The same unit is off by the same on every `day`; its noise is the day's.
  /// @throws std::invalid_argument if `firings_per_revolution` is not a positive multiple of 12.
  SpinningLidar(const LidarOptions& options, Rng unit, Index day = 0);

  [[nodiscard]] const LidarOptions& options() const { return options_; }
  [[nodiscard]] Duration period() const { return seconds(options_.period); }
  /// Time of a firing's first laser since the revolution's start.
  [[nodiscard]] Duration firing_offset(Index firing) const;
  /// Time between a firing's first laser and this one. HDL-32E: 1.152 us a laser.
  [[nodiscard]] static Duration laser_offset(Index laser) { return Duration(laser * 1152); }
  /// True pose of the sensor, not the one that an estimator is told.
  [[nodiscard]] const SE3d& true_T_body_lidar() const { return true_T_body_lidar_; }
  /// Elevation that the sensor reports for a laser, radians.
  [[nodiscard]] static double nominal_elevation(Index laser);

  /// Revolution `index`, which starts `index` periods after the drive. The result depends on the arguments alone.
  [[nodiscard]] Revolution turn(const RayCaster& world, const Drive& drive, Index index) const;

  /// The revolution as the library's record. `epoch` is the drive's start; a scan ends with its last firing, whether or
  /// not that one came back.
  [[nodiscard]] LidarScan to_scan(const Revolution& revolution, Timestamp epoch) const;

 private:
  struct Laser {
    Eigen::Vector3d nominal;  ///< unit vector in the lidar frame at the firing's azimuth 0
    Eigen::Vector3d actual;
    double range_bias;  ///< metres
  };

  void fire(const RayCaster& world, const SE3d& T_map_lidar, Index firing, Rng rng,
            std::vector<LidarReturn>& returns) const;

  LidarOptions options_;
  Rng noise_;
  SE3d true_T_body_lidar_;
  std::vector<Laser> lasers_;
};

}  // namespace chainslam::simulator
