#pragma once

#include <Eigen/Core>

#include "chainslam/core/timestamp.hpp"

namespace chainslam {

/// One measurement of an IMU, in its own frame (`body`).
struct ImuSample {
  Timestamp time{};                                 ///< of the measurement
  Eigen::Vector3d gyro = Eigen::Vector3d::Zero();   ///< angular rate, rad/s
  Eigen::Vector3d accel = Eigen::Vector3d::Zero();  ///< specific force, m/s^2: +9.81 upwards at rest
  bool rate_measured = true;                        ///< false: `gyro` is no measurement, an axis of it is stuck
  bool force_measured = true;                       ///< the same of `accel`
};

}  // namespace chainslam
