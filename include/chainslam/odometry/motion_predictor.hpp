#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <optional>

#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/odometry/deskew.hpp"
#include "chainslam/odometry/imu_initializer.hpp"
#include "chainslam/odometry/imu_rotation.hpp"
#include "chainslam/sensor/imu_sample.hpp"

namespace chainslam {

/// Where the body should be at the end of the next scan.
struct MotionPrediction {
  Timestamp time;
  double interval = 0;  ///< seconds since the last known pose
  SE3d T_odom_body{};
  Vector6d twist = Vector6d::Zero();  ///< mean over the interval, per second, body frame, [translation; rotation]
  double error = 0;                   ///< metres the pose may be off
  bool with_gyro = false;             ///< the rotation was measured, not extrapolated
};

/// Continues the motion of the last intervals: constant twist, its rotation replaced by the gyroscope's where there is
/// one.
///
/// The error to be expected is learnt from how far earlier predictions were off (as the adaptive threshold of KISS-ICP,
/// Vizzo et al. 2023, eq. 8-9).
struct MotionPredictorOptions {
  double initial_error = 2.0;    ///< metres a prediction may be off while the motion is unknown
  double min_error = 0.3;        ///< metres a prediction may be off when the motion is steady
  double max_gap = 1.0;          ///< seconds over which motion is extrapolated; after a longer pause it is unknown
  double gyro_bias_gain = 0.02;  ///< share of the rate difference to the found rotation taken into the bias, per scan
};

class MotionPredictor {
 public:
  explicit MotionPredictor(const MotionPredictorOptions& options = {}) : options_(options) {}

  /// @returns false if the sample was dropped. Readings older than the longest memory are forgotten.
  bool add(const ImuSample& sample) {
    if (!imu_.add(sample)) return false;
    imu_.forget_before(sample.time - imu_memory);
    return true;
  }

  /// Begins at the origin, with +z against gravity if the IMU has told where that is.
  ImuStart start(Timestamp time, const ImuInitializer& initializer) {
    const ImuStart imu_start = initializer.estimate(imu_.samples());
    gyro_bias_ = imu_start.gyro_bias;
    time_ = time;
    T_odom_body_ = SE3d(gravity_aligned(imu_start.up_body), Eigen::Vector3d::Zero());
    return imu_start;
  }

  [[nodiscard]] MotionPrediction predict(Timestamp time) const {
    MotionPrediction prediction{.time = time, .interval = to_seconds(time - time_)};
    const bool known = twist_.has_value() && prediction.interval <= options_.max_gap;
    if (known) prediction.twist = *twist_;
    if (const auto R = imu_.rotation(time_, time, gyro_bias_); R && prediction.interval > 0) {
      prediction.twist.tail<3>() = R->log() / prediction.interval;
      prediction.with_gyro = true;
    }
    prediction.T_odom_body = T_odom_body_.retract(prediction.twist * prediction.interval);
    prediction.error =
        known ? std::clamp(3 * error_, options_.min_error, options_.initial_error) : options_.initial_error;
    return prediction;
  }

  /// The twist with which to correct the sweep that ends at this pose; the gyroscope's rates are kept if it measured
  /// them.
  [[nodiscard]] Vector6d twist_to(const MotionPrediction& prediction, const SE3d& T_odom_body) const {
    Vector6d twist = smoothed(T_odom_body_.local(T_odom_body) / prediction.interval);
    if (prediction.with_gyro) twist.tail<3>() = prediction.twist.tail<3>();
    return twist;
  }

  /// The motion during a sweep: translation by the twist, rotation by the gyroscope or, without it, by the twist.
  [[nodiscard]] SweepMotion sweep_motion(Timestamp begin, Timestamp end, const Vector6d& twist) const {
    const double duration = to_seconds(end - begin);
    if (!imu_.rotation(begin, end, gyro_bias_)) return SweepMotion::constant_twist(duration, twist);
    const double angle = twist.tail<3>().norm() * duration;
    return SweepMotion::sample(duration, angle, [&](double offset) {
      const auto R_body_end = imu_.rotation(begin + seconds(offset), end, gyro_bias_);
      const SE3d T_end_body = SE3d::exp((offset - duration) * twist);
      return R_body_end ? SE3d(R_body_end->inverse(), T_end_body.translation()) : T_end_body;
    });
  }

  /// Takes the pose that was found where one had been predicted.
  void follow(const MotionPrediction& prediction, const SE3d& T_odom_body) {
    const Vector6d twist = T_odom_body_.local(T_odom_body) / prediction.interval;
    if (prediction.with_gyro) gyro_bias_ -= options_.gyro_bias_gain * (twist - prediction.twist).tail<3>();
    if (twist_) {
      constexpr double memory = 0.9;
      const double off = deviation(prediction, T_odom_body);
      error_ = std::sqrt(memory * error_ * error_ + (1 - memory) * off * off);
    }
    twist_ = smoothed(twist);
    time_ = prediction.time;
    T_odom_body_ = T_odom_body;
  }

  /// No pose was found: goes on at the predicted one, and expects the next prediction to be off by more.
  void lose(const MotionPrediction& prediction) {
    error_ = std::max(2 * error_, options_.min_error);
    time_ = prediction.time;
    T_odom_body_ = prediction.T_odom_body;
  }

  /// How far a prediction put the surroundings from where they were found, metres.
  [[nodiscard]] static double deviation(const MotionPrediction& prediction, const SE3d& T_odom_body) {
    constexpr double lever = 10;  // metres: a near wall; far points say less about the error that registration meets
    const Vector6d off = prediction.T_odom_body.local(T_odom_body);
    return off.head<3>().norm() + lever * off.tail<3>().norm();
  }

  [[nodiscard]] const SE3d& T_odom_body() const { return T_odom_body_; }
  [[nodiscard]] Timestamp time() const { return time_; }
  [[nodiscard]] const Eigen::Vector3d& gyro_bias() const { return gyro_bias_; }
  /// Whether a motion is known to continue.
  [[nodiscard]] bool moving() const { return twist_.has_value(); }

 private:
  /// The mean of the interval's twist and the smoothed one before. A sweep measures about the pose at its middle: with
  /// the twist of one interval alone an error e of the last pose comes back as -e in this one, undamped.
  [[nodiscard]] Vector6d smoothed(const Vector6d& twist) const {
    return twist_ ? Vector6d(0.5 * (*twist_ + twist)) : twist;
  }

  static constexpr Duration imu_memory = std::chrono::seconds(5);

  MotionPredictorOptions options_;
  ImuRotation imu_;
  Eigen::Vector3d gyro_bias_ = Eigen::Vector3d::Zero();  ///< rad/s
  Timestamp time_;                                       ///< of the last pose
  SE3d T_odom_body_;
  std::optional<Vector6d> twist_;  ///< smoothed, per second; nothing while unknown
  double error_ = 0;               ///< metres, smoothed
};

}  // namespace chainslam
