#pragma once

#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "simulator/lidar_model.hpp"
#include "simulator/rig.hpp"

namespace chainslam::simulator {

/// A spinning LiDAR, how far it is from its data sheet, and what glass, wind and weather do to its returns.
struct LidarOptions {
  LidarKind kind = LidarKind::hdl_32e;
  SE3d T_body_lidar = nominal_T_body_lidar();  ///< where it is said to sit
  Index firings_per_revolution =
      600;                      ///< a multiple of a packet's firings; the model's for all that the real one makes
  double period = 0.1;          ///< seconds per revolution
  double max_range = 100.0;     ///< metres
  double min_range = 1.0;       ///< metres
  double range_noise = 0.015;   ///< standard deviation, metres
  double lost_returns = 0.005;  ///< lost whatever the surface, as a part of all
  double lost_packets = 0.0;    ///< as a part of all
  double lost_scans = 0.0;      ///< revolutions of which nothing arrives, as a part of all

  double elevation_offset_deg = 0.0;  ///< all lasers point higher than their data sheet says by this
  double elevation_error_deg = 0.1;   ///< each laser is off by 0.2 to 1 times this, either way
  double encoder_eccentricity_deg =
      0.0;                           ///< azimuths are reported too large by this ahead, too small behind: by its cosine
  double range_bias = 0.02;          ///< each laser is off by 0.5 to 1.5 times this, either way, metres
  double elevation_drift_deg = 0.0;  ///< as it warms up each laser drifts by 0.2 to 1 times this, either way, ...
  double range_drift = 0.0;          ///< ... and by 0.5 to 1.5 times this, either way, metres, ...
  double warm_up_time = 900.0;       ///< ... 63 % of it in this time, seconds
  double incidence_bias = 0.003;     ///< range grows by this times (1 / cos(incidence) - 1), at most 10 times, metres
  double intensity_bias = 0.0;       ///< range grows by this where no light returns, by nothing at half, metres
  double mount_angle_deg = 0.3;      ///< the true mounting is turned by this about a random axis
  double mount_shift = 0.02;         ///< ... and shifted by this in a random direction, metres
  double beam_width_deg =
      0.0;                    ///< of the spot, along the turn: at edges of up to 1 m in depth a return may lie between
  double clock_offset = 0.0;  ///< stamps are early by this, seconds, ...
  double clock_drift = 0.0;   ///< ... more and more, seconds per second, ...
  double clock_jitter = 0.0;  ///< ... and each revolution's by a normal error of this deviation, seconds

  double mirrored = 0.0;  ///< part of the rays on glass that report, behind the pane, what they meet as by a mirror
  double wind = 0.0;      ///< leaves sway by this, amplitude, metres
  double drops = 0.0;     ///< of rain or snow: chance of an echo per metre of the way, falling to none at 20 m
  double dimming = 0.0;   ///< part of the light that rain or snow takes per metre, on the way there and back
};

}  // namespace chainslam::simulator
