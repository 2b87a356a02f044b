#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/sensor/packet.hpp"
#include "simulator/lidar_model.hpp"
#include "simulator/lidar_options.hpp"
#include "simulator/ray_caster.hpp"
#include "simulator/traffic.hpp"
#include "simulator/vehicle_motion.hpp"

namespace chainslam::simulator {

/// One return, as the sensor reports it: with its nominal angles.
struct LidarReturn {
  Eigen::Vector3f position;  ///< lidar frame (z up), metres
  std::uint16_t firing;      ///< within the revolution
  std::uint8_t laser;        ///< in the order of firing
  std::uint8_t intensity;
  Presence presence;  ///< of what was hit: not the sensor's to know
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
  /// The same unit is off by the same on every `day`; its noise is the day's.
  /// @throws std::invalid_argument if `firings_per_revolution` is not a positive multiple of a packet's firings.
  SpinningLidar(const LidarOptions& options, Rng unit, Index day = 0);

  [[nodiscard]] const LidarOptions& options() const { return options_; }
  [[nodiscard]] const LidarModel& model() const { return *model_; }
  [[nodiscard]] Index lasers() const { return to_index(model_->channels.size()); }
  [[nodiscard]] Duration period() const { return seconds(options_.period); }
  /// Time of a firing's first laser since the revolution's start.
  [[nodiscard]] Duration firing_offset(Index firing) const;
  /// Time between a firing's first laser and this one.
  [[nodiscard]] Duration laser_offset(Index laser) const { return channel(laser).delay; }
  /// When the revolution's last laser has fired, since the revolution's start.
  [[nodiscard]] Duration last_return() const {
    return firing_offset(options_.firings_per_revolution - 1) + firing_duration_;
  }
  /// True pose of the sensor, not the one that an estimator is told.
  [[nodiscard]] const SE3d& true_T_body_lidar() const { return true_T_body_lidar_; }
  /// Elevation that the sensor reports for a laser, radians.
  [[nodiscard]] double nominal_elevation(Index laser) const;

  /// Whether anything of revolution `index` arrives.
  [[nodiscard]] bool arrives(Index index) const;

  /// Revolution `index`, which starts `index` periods after the drive. The result depends on the arguments alone.
  /// @param passing  whoever is on the way during it: `Traffic::during` from its start to its end.
  [[nodiscard]] Revolution turn(const RayCaster& world, const VehicleMotion& drive, Index index,
                                std::span<const Passing> passing = {}) const;

  /// The revolution as the library's record. `epoch` is the drive's start; a scan ends with its last firing, whether or
  /// not that one came back.
  [[nodiscard]] LidarScan to_scan(const Revolution& revolution, Timestamp epoch) const;

 private:
  struct Laser {
    Eigen::Vector3d nominal;  ///< unit vector in the lidar frame at the firing's azimuth 0
    Eigen::Vector3d actual;
    double range_bias;       ///< metres
    double azimuth;          ///< of both vectors, radians
    double elevation;        ///< of `actual`, radians
    double elevation_drift;  ///< once the sensor is warm, radians
    double range_drift;      ///< ... metres
  };

  [[nodiscard]] const LidarChannel& channel(Index laser) const {
    return model_->channels[static_cast<std::size_t>(laser)];
  }
  /// The lasers as they are so long after the start, seconds.
  [[nodiscard]] std::vector<Laser> lasers_at(double time) const;
  /// One firing: where and when it happens.
  struct Shot {
    SE3d T_map_lidar;
    double time;  ///< since the drive's start, seconds
    Index firing;
    Rng rng;
  };
  /// What the firing before leaves for the next, and what surrounds them.
  struct Surroundings {
    const RayCaster& world;
    std::span<const Passing> passing;
    std::vector<Laser> lasers;
    std::vector<float> previous;  ///< each laser's true range in the firing before, infinite if there was none
  };

  void fire(Surroundings& around, Shot shot, std::vector<LidarReturn>& returns) const;

  LidarOptions options_;
  const LidarModel* model_;
  Duration firing_duration_;  ///< from the first laser to the end of the last
  float half_spread_;         ///< sine of how far a firing's rays lie off its azimuth at most, with room for a tilt
  Rng noise_;
  SE3d true_T_body_lidar_;
  std::vector<Laser> lasers_;
};

}  // namespace chainslam::simulator
