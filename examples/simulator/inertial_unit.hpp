#pragma once

#include <Eigen/Core>
#include <limits>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sensor/packet.hpp"
#include "simulator/vehicle_motion.hpp"

namespace chainslam::simulator {

constexpr double gravity = 9.81;  ///< m/s^2, along -z of the map

/// An inertial unit, by default of the grade of Microstrain's 3DM-GX3-25.
struct InertialOptions {
  double rate = 100.0;             ///< Hz
  double gyro_noise = 5e-4;        ///< rad/s per sqrt(Hz)
  double accel_noise = 8e-4;       ///< m/s^2 per sqrt(Hz)
  double gyro_bias = 3e-3;         ///< standard deviation when switched on, rad/s
  double accel_bias = 0.03;        ///< standard deviation when switched on, m/s^2
  double gyro_bias_walk = 2e-5;    ///< rad/s per sqrt(s)
  double accel_bias_walk = 2e-4;   ///< m/s^2 per sqrt(s)
  double scale = 2e-3;             ///< standard deviation of each axis' scale error
  double misalignment_deg = 0.05;  ///< standard deviation of the angles between nominal and true axes
  double gyro_warm_up = 0.0;       ///< as it warms up each bias moves by so many rad/s in standard deviation, ...
  double accel_warm_up = 0.0;      ///< ... m/s^2, ...
  double warm_up_time = 600.0;     ///< ... 63 % of it in this time, seconds
  double g_sensitivity = 0.0;      ///< standard deviation of the gyroscopes' answer to specific force, rad/s per m/s^2
  double shake_gyro = 0.0;         ///< amplitude of what engine and wheels shake at 1 m/s and more, rad/s, ...
  double shake_accel = 0.0;        ///< ... and m/s^2, in each axis, sampled without a filter before it
  double shake_frequency = 37.0;   ///< Hz; each axis has its own, 0.8 to 1.2 times this
  double clock_offset = 0.0;       ///< samples are stamped this much too early, seconds, ...
  double clock_jitter = 0.0;       ///< ... give or take up to this, at most 0.45 periods, seconds
  double gyro_range = std::numeric_limits<double>::infinity();   ///< readings saturate here, rad/s
  double accel_range = std::numeric_limits<double>::infinity();  ///< ... and here, m/s^2

  /// A perfect instrument at the same rate.
  [[nodiscard]] InertialOptions without_errors() const;
};

/// The whole drive as the unit (the body frame) feels it. Samples are instantaneous, at multiples of 1 / rate from
/// `epoch`. The same unit has the same scales and axes on every `day`; its biases and noise are the day's.
[[nodiscard]] std::vector<ImuSample> record_imu(const VehicleMotion& drive, const InertialOptions& options,
                                                Timestamp epoch, const Rng& unit, Index day = 0);

}  // namespace chainslam::simulator
