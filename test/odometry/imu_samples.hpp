#pragma once

#include <Eigen/Core>

#include "chainslam/lie/so3.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam::test {

inline ImuSample sample_at(double t, const Eigen::Vector3d& gyro, const Eigen::Vector3d& accel = {0, 0, 9.81}) {
  return {.time = Timestamp::from_seconds(t), .gyro = gyro, .accel = accel};
}

inline Timestamp at(double t) { return Timestamp::from_seconds(t); }

inline double angle_between(const SO3d& a, const SO3d& b) { return (a.inverse() * b).log().norm(); }

}  // namespace chainslam::test
