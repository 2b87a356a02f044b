#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/odometry/detail/imu_monitor.hpp"
#include "chainslam/odometry/inertial_motion_options.hpp"

namespace chainslam::detail {

/// How a body moves at a moment.
struct MomentaryMotion {
  Eigen::Vector3d velocity = zeros<Eigen::Vector3d>();  ///< m/s, of the frame that poses are in
  Eigen::Vector3d rate = zeros<Eigen::Vector3d>();      ///< rad/s, body frame

  /// By how much the body turns in `time` seconds.
  [[nodiscard]] SO3d turn(double time) const { return SO3d::exp(scaled(time, rate)); }
  /// Where a body at T is `time` seconds later.
  [[nodiscard]] SE3d later(const SE3d& T, double time) const {
    if (time == 0) return T;
    return SE3d(T.rotation() * turn(time), sum_of(T.translation(), scaled(time, velocity)));
  }
  /// d later / d time, tangent [translation; rotation] there. @param R  rotation of the body there.
  [[nodiscard]] Vector6d twist(const SO3d& R) const {
    Vector6d twist = zeros<Vector6d>();
    set_block(twist, 0, 0, R.inverse() * velocity);
    set_block(twist, 3, 0, rate);
    return twist;
  }
};

/// The error of a scan's time: the scan was taken at the stated time + `value()`, of which only a deviation is known
/// beforehand.
///
/// It is estimated with the state, as Qin and Shen (2018, IROS, "Online temporal calibration for monocular
/// visual-inertial systems", eq. 5 and 6) shift features by a time offset times their velocity, but separately for each
/// scan. Equations of the scan's pose are freed of it by the Schur complement, which is the same as measurement noise
/// along the motion; its own value follows from how the pose then moves.
class TimeError {
 public:
  /// @param deviation  seconds; 0: the time is exact.
  explicit TimeError(double deviation = 0) : information_(deviation > 0 ? 1 / (deviation * deviation) : 0.0) {}

  [[nodiscard]] bool exact() const { return information_ == 0; }
  [[nodiscard]] double value() const { return value_; }  ///< seconds
  /// Squared deviations that the value is off zero.
  [[nodiscard]] double squared_error() const { return information_ * value_ * value_; }
  /// By how much the value changes if the pose stays, seconds.
  [[nodiscard]] double step() const { return exact() ? 0.0 : gradient_ / curvature_; }

  /// Goes on to the solution of the last equations. @param moved  by how much the pose has moved at the same time.
  void follow(const Vector6d& moved) {
    if (exact()) return;
    value_ += (gradient_ - transposed_product(coupling_, moved)(0, 0)) / curvature_;
    gradient_ = 0;
    coupling_ = zeros<Vector6d>();
  }

  /// Takes the equations of the pose, and leaves what they say of it if the time error is free: H and g of
  /// |r|^2 = squared_error - 2 g . d + d . H d. @param twist  d pose / d time.
  void eliminate(const Vector6d& twist, Matrix6d& H, Vector6d& g, double& squared_error) {
    if (exact()) return;
    coupling_ = product(H, twist);
    curvature_ = transposed_product(twist, coupling_)(0, 0) + information_;
    gradient_ = transposed_product(twist, g)(0, 0) - information_ * value_;
    squared_error += information_ * value_ * value_ - gradient_ * gradient_ / curvature_;
    for (int j = 0; j < 6; ++j) {
      for (int i = 0; i < 6; ++i) H(i, j) -= coupling_[i] * coupling_[j] / curvature_;
      g[j] -= coupling_[j] * gradient_ / curvature_;
    }
  }

 private:
  double information_, value_ = 0, gradient_ = 0, curvature_ = 1;
  Vector6d coupling_ = zeros<Vector6d>();
};

/// Learns how far the times of scans are off.
///
/// A scan that was taken too late lies ahead. Of four scans in a row, the third difference of what they say of the
/// position, less what was measured of the acceleration, shows the errors of their times along the way, whatever
/// gravity and bias are; what it shows across the way is noise of another kind, and is taken off. No estimate of the
/// filter is used: one that believes the clock too much or too little would confirm itself.
class ScanClock {
 public:
  /// Starts without knowledge.
  explicit ScanClock(const ScanClockOptions& options = {}) : options_(options) {
    weight_ = options_.start_speed * options_.start_speed;
  }

  /// Seconds, standard deviation of a scan's time; 0: taken as exact.
  [[nodiscard]] double deviation() const {
    const double learned = std::sqrt(std::max(0.0, sum_ / weight_));
    return learned < options_.least ? 0.0 : std::min(learned, options_.largest);
  }

  /// Takes what was measured on the way to a scan. @param position  of the body at the scan, by the scan alone, odom.
  /// @param velocity  m/s, odom.
  void follow(const ImuComparison& comparison, const Eigen::Vector3d& position, const Eigen::Vector3d& velocity);
  /// The next scans have nothing to do with those before.
  void interrupt() { steps_ = 0; }

 private:
  /// From one scan to the next.
  struct Step {
    double duration = 0;                                ///< seconds
    Eigen::Vector3d way = zeros<Eigen::Vector3d>();     ///< metres, less what the acceleration made of it
    Eigen::Vector3d gained = zeros<Eigen::Vector3d>();  ///< m/s, by the acceleration
  };
  /// Second difference of three scans' positions.
  struct Bend {
    Eigen::Vector3d off = zeros<Eigen::Vector3d>();    ///< metres, less what the acceleration made of it
    Eigen::Vector3d parts = zeros<Eigen::Vector3d>();  ///< of the three positions in it

    Bend() = default;
    Bend(const Step& before, const Step& now);
  };
  void learn(const Bend& before, const Bend& now, double interval, const Eigen::Vector3d& velocity);

  ScanClockOptions options_;
  int steps_ = 0;  ///< scans in a row
  Eigen::Vector3d position_ = zeros<Eigen::Vector3d>();
  Step last_;
  Bend bend_;
  double sum_ = 0, weight_;  ///< of (speed * deviation)^2, m^2, and of squared speeds
};

inline void ScanClock::follow(const ImuComparison& comparison, const Eigen::Vector3d& position,
                              const Eigen::Vector3d& velocity) {
  if (!(options_.largest > 0)) return;
  const double dt = comparison.interval;
  const bool measured = dt > 0 && dt <= options_.max_step && comparison.force_measured;
  if (!measured) steps_ = 0;
  if (steps_ > 0) {
    const Eigen::Vector3d by_force = difference_of(comparison.force_way, scaled(0.5 * dt * dt, comparison.expected_up));
    const Eigen::Vector3d gained = scaled(dt, difference_of(comparison.force, comparison.expected_up));
    const Step now{dt, difference_of(difference_of(position, position_), by_force), gained};
    if (steps_ > 1) {
      const Bend bend(last_, now);
      if (steps_ > 2) learn(bend_, bend, dt, velocity);
      bend_ = bend;
    }
    last_ = now;
  }
  position_ = position;
  steps_ = std::min(steps_ + 1, 3);
}

inline ScanClock::Bend::Bend(const Step& before, const Step& now) {
  const double a = before.duration, b = now.duration, mean = 2 * a * b / (a + b);
  const Eigen::Vector3d slopes = difference_of(divided(now.way, b), divided(before.way, a));
  off = scaled(mean, difference_of(slopes, before.gained));
  parts = {mean / a, -mean / a - mean / b, mean / b};
}

inline void ScanClock::learn(const Bend& before, const Bend& now, double interval, const Eigen::Vector3d& velocity) {
  const double speed = velocity.norm(), kept = std::exp(-interval / options_.memory);
  const Eigen::Vector3d off = difference_of(now.off, before.off);
  const double along = speed > 0 ? off.dot(velocity) / speed : 0.0;
  const double across = 0.5 * (off.squaredNorm() - along * along);
  double variance = 0;  // by positions of variance 1: 20 if scans come evenly
  for (const double part :
       {before.parts[0], before.parts[1] - now.parts[0], before.parts[2] - now.parts[1], now.parts[2]})
    variance += part * part;
  const double most = speed * speed * options_.largest * options_.largest;
  sum_ = kept * sum_ + std::clamp((along * along - across) / variance, -most, most);
  weight_ = kept * weight_ + speed * speed;
}

}  // namespace chainslam::detail
