#pragma once

#include "chainslam/core/timestamp.hpp"
#include "chainslam/lie/so3.hpp"
#include "chainslam/sensor/imu_sample.hpp"

namespace chainslam {

/// By how much an IMU's clock and axes differ from what is given.
struct ImuCorrection {
  double time_offset = 0;  ///< seconds that stamps are late by, on the LiDAR's clock
  SO3d R_body_imu{};       ///< from the axes that the IMU measures along to those of the body

  /// The sample, corrected.
  [[nodiscard]] ImuSample operator()(ImuSample sample) const {
    sample.time = sample.time - seconds(time_offset);
    sample.gyro = R_body_imu * sample.gyro;
    sample.accel = R_body_imu * sample.accel;
    return sample;
  }
  /// What leads from samples corrected by `before` to such by this.
  [[nodiscard]] ImuCorrection since(const ImuCorrection& before) const {
    return {time_offset - before.time_offset, R_body_imu * before.R_body_imu.inverse()};
  }
};

}  // namespace chainslam
