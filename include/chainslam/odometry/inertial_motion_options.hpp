#pragma once

#include "chainslam/core/types.hpp"
#include "chainslam/odometry/imu_process.hpp"

namespace chainslam {

/// How an IMU's measurements are used.
struct ImuRecordOptions {
  double max_gap = 0.25;  ///< seconds between measurements that are joined by a line; over a longer hole there are none
  double max_step = 0.01;  ///< seconds; longer ones are divided, so that units of 10 Hz integrate as well as fast ones
  double unseen_share = 0.3;  ///< of the difference of two measurements, by which the mean between them may be off
  double memory = 5;          ///< seconds of measurements kept before the first scan
  double gyro_range = std::numeric_limits<double>::infinity();   ///< rad/s at which an axis is clipped
  double accel_range = std::numeric_limits<double>::infinity();  ///< m/s^2
  double clipped_gyro_noise = 0.5;                               ///< density while clipped, rad/s per sqrt(Hz)
  double clipped_accel_noise = 5;                                ///< m/s^2 per sqrt(Hz)
};

/// Settings of `AccelNoise`.
struct AccelNoiseOptions {
  double start = 0.02;  ///< m/s^2 per sqrt(Hz), until it is measured; 0: it is not estimated
  /// Seconds of measurements that count as much as `start`: few, for gravity is learnt in the first ones.
  double start_time = 0.5;
  double half_span = 0.5;  ///< seconds between the three positions that an acceleration is taken from
  double memory = 20;      ///< seconds
  double largest = 1;      ///< m/s^2 per sqrt(Hz): a scan that is registered to a wrong place says more
};

/// Settings of `ScanClock`.
struct ScanClockOptions {
  /// Seconds, standard deviation of scans' times from which on they count as off: registration leaves as much. Below,
  /// and until more is measured, they are taken as exact.
  double least = 2e-3;
  double largest = 0.03;   ///< seconds: a scan that is registered to a wrong place says more. 0: all times are exact
  double start_speed = 2;  ///< m/s: one scan at that speed says as much as is assumed of a clock that is right
  double memory = 20;      ///< seconds
  double max_step = 0.25;  ///< seconds between scans that are compared
};

/// When an IMU is excluded, and when it is used again.
struct ImuMonitorOptions {
  double max_pose_nis = 4;        ///< of a scan against its prediction, per direction seen; infinite: never excluded
  double max_contradictions = 3;  ///< that many scans lately, each fading by `fading` with every scan
  double odd_distance = 0.1;      ///< metres off the prediction, from which on a contradiction may be the scan's fault
  double max_odd_scans = 2.5;     ///< that many such scans lately: beyond, it is the IMU's
  double fading = 0.85;           ///< factor of earlier contradictions, per scan
  double memory = 1;              ///< seconds, of the mean errors below
  double max_rate_error = 0.03;   ///< rad/s: a bias and more; ...
  double max_rate_share = 0.05;   ///< ... and so much of the rate: scale, and axes that are not quite the given ones
  double max_accel_error = 1.0;   ///< m/s^2
  double up_memory = 5;           ///< seconds, of gravity's direction while the accelerometer is excluded
  double trial = 3;               ///< seconds in agreement with the scans until a sensor is used again; ...
  double max_trial = 60;          ///< ... doubled with every relapse up to this
};

/// Which plane is fitted to the neighbours of a point.
enum class PlaneForm {
  centred,    ///< least squares of distances, about the mean; no lines, none that hangs on one point
  intercept,  ///< least squares of a . p = -1, as FAST-LIO2 has it: no plane through the map's origin
};

/// How a scan is used as a measurement, beyond what `ScanToMap` says of matching.
struct ScanMeasurementOptions {
  PlaneForm planes = PlaneForm::centred;  ///< how planes are kept
  double fresh_distance = 0.015;          ///< metres the pose may move for planes to count as just looked up
  bool coarse_to_fine = true;             ///< gate and kernel start at the error to be expected of the prediction
  bool mean_time = true;  ///< the scan lies where the body was at the points' mean time, not at the sweep's end
};

/// Settings of `InertialMotion`.
struct InertialMotionOptions {
  ImuProcess process{.up_walk = 3.5e-4};              ///< twice that lets heights wander, a quarter loses bent maps
  ImuRecordOptions imu{};                             ///< of the record of samples
  AccelNoiseOptions accel_noise{};                    ///< above that of `process`, which is the least
  ImuInitializer initializer{.max_gyro_mean = 0.03};  ///< a bias; more is a slow turn
  double start_speed = 20;   ///< m/s, deviation of each velocity at the start: quiet measurements do not prove rest
  double rest_speed = 0.05;  ///< m/s, deviation where rest is assumed
  double start_gyro_bias = 1e-2;  ///< rad/s, deviation
  double rest_share = 0.5;  ///< of starts with quiet measurements, those at rest; the others are in a slow, steady turn
  double start_accel_bias = 0.1;  ///< m/s^2, deviation
  double start_up = 0.15;  ///< radians, deviation of gravity's direction: steady acceleration is as quiet as rest
  double rest_up = 0.01;   ///< and where rest is assumed: what the accelerometer's bias makes of it
  double start_curvature = 5e-5;  ///< 1/m, deviation of the map's bend: 0.3 degrees in 100 m
  // Without readings the body goes on as it did: constant velocity and rate, with these densities of change.
  double free_accel = 1.5;        ///< m/s^2 per sqrt(Hz)
  double free_gyro = 0.2;         ///< rad/s per sqrt(Hz)
  double max_free = 1.0;          ///< seconds that may be continued so; beyond, the body may be anywhere near
  double lost_position = 2.0;     ///< metres, deviation after that, and of a prediction that scans contradict
  double lost_rotation = 0.2;     ///< radians, deviation of the latter
  double odd_position = 0.5;      ///< metres, deviation of a single scan from where the IMU's motion leads
  double odd_rotation = 0.1;      ///< radians, the same
  double lidar_position = 0;      ///< metres, deviation of the extrinsic calibration; 0: known
  double lidar_rotation = 0.005;  ///< radians about each axis; a third of a degree off is usual, and observable
  Index mounting_after = 3;       ///< scans, from which on it is estimated: the first make a crooked map
};

}  // namespace chainslam
