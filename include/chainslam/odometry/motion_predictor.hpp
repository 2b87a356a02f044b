#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <optional>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/odometry/deskew.hpp"
#include "chainslam/odometry/detail/imu_rotation.hpp"
#include "chainslam/odometry/detail/moved_distance.hpp"
#include "chainslam/odometry/imu_process.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam {

/// Where the body should be at the end of the next scan.
struct MotionPrediction {
  Timestamp begin;                     ///< of the sweep
  Timestamp end;                       ///< of the sweep
  double since_last = 0;               ///< seconds from the last known pose to the sweep's end
  SE3d T_odom_body{};                  ///< at the sweep's end
  Vector6d twist = zeros<Vector6d>();  ///< per second, body frame, [translation; rotation]
  double error = 0;                    ///< metres the pose may be off
  bool with_gyro = false;              ///< the rotation was measured, not extrapolated
};

/// How motion is predicted from scan to scan.
struct MotionPredictorOptions {
  double initial_error = 4.0;    ///< metres a prediction may be off while the motion is unknown: 40 m/s at 10 Hz
  double min_error = 0.3;        ///< metres a prediction may be off when the motion is steady
  double max_gap = 1.0;          ///< seconds over which motion is extrapolated; after a longer pause it is unknown
  double gyro_bias_gain = 0.02;  ///< share of the rate difference to the found rotation taken into the bias, per scan
};

/// Continues the motion of the last intervals: constant twist, its rotation replaced by the gyroscope's where there is
/// one.
///
/// The error to be expected is learnt from how far earlier predictions were off (as the adaptive threshold of KISS-ICP,
/// Vizzo et al. 2023, eq. 8-9).
class MotionPredictor {
 public:
  /// Starts at rest at the origin.
  explicit MotionPredictor(const MotionPredictorOptions& options = {}) : options_(options) {}

  /// @returns false if the sample was dropped. Measurements older than the longest memory are forgotten.
  bool add(const ImuSample& sample) {
    if (!imu_.add(sample)) return false;
    imu_.forget_before(sample.time - imu_memory);
    return true;
  }

  /// Begins at the origin, at the end of the first sweep, with +z against gravity if the IMU has observed it.
  ImuStart start(Timestamp begin, Timestamp end, const ImuInitializer& initializer) {
    const ImuStart imu_start = initializer.estimate(imu_.samples());
    gyro_bias_ = imu_start.gyro_bias;
    time_ = end;
    middle_time_ = begin + (end - begin) / 2;
    T_odom_body_ = T_odom_middle_ = SE3d(gravity_aligned(imu_start.up_body), Eigen::Vector3d::Zero());
    return imu_start;
  }

  /// Whether a sweep comes after the last one, by its end and by its middle.
  [[nodiscard]] bool comes_after(Timestamp begin, Timestamp end) const {
    return end > time_ && begin + (end - begin) / 2 > middle_time_;
  }

  /// Sets the motion during the first sweep, which the second has shown.
  void correct_start(const Vector6d& twist) {
    T_odom_middle_ = T_odom_body_.retract(-to_seconds(time_ - middle_time_) * twist);
  }

  /// Where the body will be at the end of a sweep.
  [[nodiscard]] MotionPrediction predict(Timestamp begin, Timestamp end) const {
    MotionPrediction prediction{.begin = begin, .end = end, .since_last = to_seconds(end - time_)};
    const bool known = twist_.has_value() && prediction.since_last <= options_.max_gap;
    if (known) prediction.twist = *twist_;
    if (const auto R = imu_.rotation(time_, end, gyro_bias_); R && prediction.since_last > 0) {
      set_block(prediction.twist, 3, 0, Eigen::Vector3d(R->log() / prediction.since_last));
      prediction.with_gyro = true;
    }
    prediction.T_odom_body = T_odom_body_.retract(prediction.twist * prediction.since_last);
    prediction.error =
        known ? std::clamp(3 * error_, options_.min_error, options_.initial_error) : options_.initial_error;
    return prediction;
  }

  /// The motion during the sweep, now that its end has been found at `T_odom_body` after correction by `twist`; the
  /// gyroscope's rates are kept if it measured them.
  [[nodiscard]] Vector6d found_twist(const MotionPrediction& prediction, const Vector6d& twist,
                                     const SE3d& T_odom_body) const {
    Vector6d found = extrapolated(mean_twist(prediction, twist, T_odom_body));
    if (prediction.with_gyro) set_block(found, 3, 0, rotation_of(prediction.twist));
    return found;
  }

  /// The motion during a sweep: translation by the twist, rotation by the gyroscope or, without it, by the twist.
  [[nodiscard]] SweepMotion sweep_motion(Timestamp begin, Timestamp end, const Vector6d& twist) const {
    const double duration = to_seconds(end - begin);
    if (!imu_.rotation(begin, end, gyro_bias_)) return SweepMotion::constant_twist(duration, twist);
    const double angle = rotation_of(twist).norm() * duration;
    return SweepMotion::sample(duration, angle, [&](double offset) {
      const auto R_body_end = imu_.rotation(begin + seconds(offset), end, gyro_bias_);
      const SE3d T_end_body = SE3d::exp(scaled(offset - duration, twist));
      return R_body_end ? SE3d(R_body_end->inverse(), T_end_body.translation()) : T_end_body;
    });
  }

  /// How far the body at the sweep's end may lie from where its middle, which is what was measured, puts it: by half of
  /// the change of twist over half of the sweep. Tangent of the pose at the end.
  [[nodiscard]] Vector6d end_deviation(const MotionPrediction& prediction, const Vector6d& twist,
                                       const SE3d& T_odom_body) const {
    if (!mean_twist_) return zeros<Vector6d>();
    const Vector6d change = difference_of(mean_twist(prediction, twist, T_odom_body), *mean_twist_);
    Vector6d deviation = scaled(0.25 * to_seconds(prediction.end - prediction.begin), change);
    if (prediction.with_gyro) set_block(deviation, 3, 0, zeros<Eigen::Vector3d>());
    return deviation;
  }

  /// Covariance of where the first pose lies among those after it, as the second sweep leaves it: an acceleration,
  /// which two sweeps do not show, moves their ends against the motion from middle to middle.
  [[nodiscard]] static Matrix6d start_covariance(const MotionPrediction& second) {
    constexpr double acceleration = 2;  // m/s^2, deviation: half of what cars do
    const double deviation = 0.5 * acceleration * to_seconds(second.end - second.begin) * second.since_last;
    Matrix6d covariance = Matrix6d::Zero();
    for (int i = 0; i < 3; ++i) covariance(i, i) = deviation * deviation;
    return covariance;
  }

  /// Takes the pose that was found where one had been predicted, and the twist the sweep was corrected by.
  void follow(const MotionPrediction& prediction, const Vector6d& twist, const SE3d& T_odom_body) {
    if (prediction.with_gyro) {
      const Eigen::Vector3d rate = rotation_of(T_odom_body_.local(T_odom_body)) / prediction.since_last;
      const Eigen::Vector3d excess = rate - rotation_of(prediction.twist);
      gyro_bias_ = difference_of(gyro_bias_, scaled(options_.gyro_bias_gain, excess));
    }
    if (twist_) {
      constexpr double memory = 0.9;
      const double off = deviation(prediction, T_odom_body);
      error_ = std::sqrt(memory * error_ * error_ + (1 - memory) * off * off);
    }
    const Vector6d mean = mean_twist(prediction, twist, T_odom_body);
    twist_ = extrapolated(mean);
    mean_twist_ = mean;
    middle_time_ = middle(prediction);
    T_odom_middle_ = at_middle(prediction, twist, T_odom_body);
    time_ = prediction.end;
    T_odom_body_ = T_odom_body;
  }

  /// No pose was found: goes on at the predicted one, and expects the next prediction to be off by more.
  void lose(const MotionPrediction& prediction) {
    error_ = std::max(2 * error_, options_.min_error);
    middle_time_ = middle(prediction);
    T_odom_middle_ = at_middle(prediction, prediction.twist, prediction.T_odom_body);
    time_ = prediction.end;
    T_odom_body_ = prediction.T_odom_body;
  }

  /// How far a prediction put the surroundings from where they were found, metres.
  [[nodiscard]] static double deviation(const MotionPrediction& prediction, const SE3d& T_odom_body) {
    constexpr double lever = 10;  // metres: a near wall; far points say less about the error that registration meets
    const Vector6d off = prediction.T_odom_body.local(T_odom_body);
    return detail::moved_distance(off, lever);
  }

  [[nodiscard]] const SE3d& T_odom_body() const { return T_odom_body_; }         ///< at `time()`
  [[nodiscard]] Timestamp time() const { return time_; }                         ///< of the last pose
  [[nodiscard]] const Eigen::Vector3d& gyro_bias() const { return gyro_bias_; }  ///< rad/s, as learnt so far
  /// Whether a motion is known to continue.
  [[nodiscard]] bool moving() const { return twist_.has_value(); }

 private:
  // A sweep measures the pose at its middle, whatever twist corrects it; the pose at its end is that and half of the
  // twist. Were motion taken from one end to the next, an error e of the last end would come back as -e in this one,
  // undamped. Therefore motion is taken from middle to middle.

  [[nodiscard]] static Timestamp middle(const MotionPrediction& sweep) {
    return sweep.begin + (sweep.end - sweep.begin) / 2;
  }
  [[nodiscard]] static SE3d at_middle(const MotionPrediction& sweep, const Vector6d& twist, const SE3d& T_odom_end) {
    return T_odom_end.retract(scaled(-to_seconds(sweep.end - middle(sweep)), twist));
  }
  /// From the middle of the last sweep to that of this one, per second.
  [[nodiscard]] Vector6d mean_twist(const MotionPrediction& sweep, const Vector6d& twist,
                                    const SE3d& T_odom_end) const {
    const double interval = to_seconds(middle(sweep) - middle_time_);
    Vector6d mean = T_odom_middle_.local(at_middle(sweep, twist, T_odom_end));
    for (int i = 0; i < 6; ++i) mean[i] /= interval;
    return mean;
  }
  /// A mean over an interval holds at its middle. This carries it on towards the interval's end by half of what
  /// constant acceleration asks for: the other half would cost more in noise than it brings.
  [[nodiscard]] Vector6d extrapolated(const Vector6d& mean) const {
    if (!mean_twist_) return mean;
    return sum_of(mean, scaled(0.25, difference_of(mean, *mean_twist_)));
  }
  [[nodiscard]] static Eigen::Vector3d rotation_of(const Vector6d& twist) { return block_of<3, 1>(twist, 3, 0); }

  static constexpr Duration imu_memory = std::chrono::seconds(5);

  MotionPredictorOptions options_;
  detail::ImuRotation imu_;
  Eigen::Vector3d gyro_bias_ = Eigen::Vector3d::Zero();  ///< rad/s
  Timestamp time_;                                       ///< of the last pose
  SE3d T_odom_body_;
  Timestamp middle_time_;               ///< of the last sweep
  SE3d T_odom_middle_;                  ///< the body there
  std::optional<Vector6d> mean_twist_;  ///< from the middle of the sweep before to that of the last, per second
  std::optional<Vector6d> twist_;       ///< at the end of the last sweep, per second; nothing while unknown
  double error_ = 0;                    ///< metres, smoothed
};

}  // namespace chainslam
