#pragma once

#include "chainslam/core/types.hpp"
#include "chainslam/odometry/accel_noise.hpp"
#include "chainslam/odometry/imu_initializer.hpp"
#include "chainslam/odometry/imu_process.hpp"
#include "chainslam/odometry/imu_record.hpp"

namespace chainslam {

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
  double start_up = 0.15;    ///< radians, deviation of gravity's direction: steady acceleration is as quiet as rest
  double rest_up = 0.01;     ///< and where rest is assumed: what the accelerometer's bias makes of it
  double start_bend = 5e-5;  ///< 1/m, deviation of the map's bend: 0.3 degrees in 100 m
  // Without readings the body goes on as it did: constant velocity and rate, with these densities of change.
  double free_accel = 1.5;        ///< m/s^2 per sqrt(Hz)
  double free_gyro = 0.2;         ///< rad/s per sqrt(Hz)
  double max_free = 1.0;          ///< seconds that may be continued so; beyond, the body may be anywhere near
  double lost_position = 2.0;     ///< metres, deviation after that, and of a prediction that scans contradict
  double lost_rotation = 0.2;     ///< radians, deviation of the latter
  double lidar_position = 0;      ///< metres, deviation of the extrinsic calibration; 0: known
  double lidar_rotation = 0.005;  ///< radians about each axis; a third of a degree off is usual, and observable
  Index mounting_after = 3;       ///< scans, from which on it is estimated: the first make a crooked map
};

}  // namespace chainslam
