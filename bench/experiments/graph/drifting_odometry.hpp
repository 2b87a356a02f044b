#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>

#include "chainslam/core/random.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/lie/se3.hpp"
#include "simulator/town_drive.hpp"

namespace chainslam::experiments {

/// Odometry that knows where gravity points: what drifts is its position and its heading.
class DriftingOdometry {
 public:
  explicit DriftingOdometry(Rng rng) : rng_(rng) {
    for (int k = 0; k < 3; ++k) bias_[k] = rng_.normal(0, bias);
  }

  /// The pose after the truth has moved on. @returns T_odom_body
  const SE3d& follow(const SE3d& T_map_body) {
    if (!truth_) T_odom_body_ = SE3d(T_map_body.rotation(), Eigen::Vector3d::Zero());
    const SE3d step = truth_.value_or(T_map_body).inverse() * T_map_body;
    const double length = step.translation().norm();
    Vector6d error;
    for (int k = 0; k < 3; ++k) error[k] = bias_[k] * length + rng_.normal(0, noise * std::sqrt(length));
    error.tail<3>() =
        T_map_body.rotation().inverse() * Eigen::Vector3d(0, 0, rng_.normal(0, turning * std::sqrt(length)));
    T_odom_body_ *= step * SE3d::exp(error);
    truth_ = T_map_body;
    return T_odom_body_;
  }

 private:
  // Deviations: of a session's constant error, metres per metre; of a metre's in position and in heading.
  static constexpr double bias = 1e-3, noise = 0.01, turning = 3e-4;

  Rng rng_;
  Eigen::Vector3d bias_;
  std::optional<SE3d> truth_;
  SE3d T_odom_body_;
};

/// Integral of the specific force that the IMU measured between two scans, m/s, body frame at the later one.
class ForceIntegral {
 public:
  explicit ForceIntegral(const simulator::TownDrive& drive) : drive_(drive), last_(drive.epoch()) {}

  [[nodiscard]] Eigen::Vector3f until(Timestamp end) {
    const SO3d R_end_map = drive_.truth(end).rotation().inverse();
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (; last_ < end; ++next_) {
      const ImuSample& sample = drive_.imu().at(next_);
      if (sample.time <= last_) continue;
      const Timestamp stop = std::min(sample.time, end);
      sum += to_seconds(stop - last_) * (R_end_map * (drive_.truth(stop).rotation() * sample.accel));
      last_ = stop;
      if (sample.time > end) return sum.cast<float>();  // the rest of the sample's time is the next scan's
    }
    return sum.cast<float>();
  }

 private:
  const simulator::TownDrive& drive_;
  Timestamp last_;
  std::size_t next_ = 0;
};

}  // namespace chainslam::experiments
