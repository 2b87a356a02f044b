#pragma once

#include <Eigen/Core>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/sensor/packet.hpp"
#include "simulator/ray_caster.hpp"
#include "simulator/rig.hpp"
#include "simulator/vehicle_motion.hpp"

namespace chainslam::simulator {

/// A consumer's receiver in a town.
struct GnssOptions {
  double rate = 2.0;                   ///< Hz
  double least_bias = 1.0;             ///< horizontal length of the session's constant error, metres: from this ...
  double most_bias = 3.0;              ///< ... to this
  double wander = 1.5;                 ///< standard deviation of the Gauss-Markov error, horizontal, metres
  double wander_time = 60.0;           ///< its correlation time, seconds
  double noise = 1.0;                  ///< white, horizontal, metres
  double vertical = 2.0;               ///< vertical errors are this many times the horizontal ones
  double time_between_outages = 30.0;  ///< mean, seconds; 0.5 to 1.5 times that, and before the first as well
  double outage_duration = 6.0;        ///< mean, seconds; 0.5 to 1.5 times that
  double time_between_bursts = 0.0;    ///< of multipath, mean, seconds, 0.5 to 1.5 times that; 0: none
  double burst_duration = 8.0;         ///< mean, seconds; 0.5 to 1.5 times that
  double burst_size = 10.0;  ///< standard deviation of a burst's displacement, metres; the receiver does not know of it
  double flat_fixes = 0.0;   ///< part of the fixes that are two-dimensional, their altitude not a number
  double latency = 0.0;      ///< fixes are stamped this much later than they are true, seconds
  bool needs_sky = false;    ///< what stands around and above loses fixes, and makes bursts more frequent and larger
  Eigen::Vector3d antenna_body = nominal_antenna_body();  ///< metres
};

/// A line of the receiver's log.
struct GnssReading {
  Timestamp time;
  int mode = 0;  ///< 0: no fix; 2: without altitude; 3: three-dimensional
  int satellites = 0;
  double latitude = 0.0;   ///< radians; of the last fix where there is none
  double longitude = 0.0;  ///< radians
  double altitude = 0.0;   ///< metres; not a number where there is no fix
  double track = 0.0;      ///< course over ground, radians clockwise from north
  double speed = 0.0;      ///< m/s
  GnssFix fix;             ///< the same for the library; its covariance is what the receiver believes
};

/// The map frame on the Earth: x north, y west, z up at NCLT's origin (42.293227 N, 83.709657 W, 270 m).
[[nodiscard]] Eigen::Vector3d map_to_geodetic(const Eigen::Vector3d& position_map);  ///< rad, rad, m
[[nodiscard]] Eigen::Vector3d map_to_ecef(const Eigen::Vector3d& position_map);      ///< metres

/// The part of the sky above 15 degrees that is seen from a place, 0 to 1, by 24 rays.
[[nodiscard]] double open_sky(const RayCaster& world, const Eigen::Vector3d& position);

/// The antenna's positions through the drive, at multiples of 1 / rate from `epoch`, outages included.
[[nodiscard]] std::vector<GnssReading> record_gnss(const VehicleMotion& drive, const RayCaster& world,
                                                   const GnssOptions& options, Timestamp epoch, Rng rng);

}  // namespace chainslam::simulator
