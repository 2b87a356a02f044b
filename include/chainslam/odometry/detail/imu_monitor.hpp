#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/lie/s2.hpp"
#include "chainslam/odometry/inertial_motion_options.hpp"
#include "chainslam/sensor/frame.hpp"

namespace chainslam::detail {

/// What an IMU measured between two scans, beside what the scans say; odom frame where not said otherwise.
struct ImuComparison {
  double interval = 0;                                    ///< seconds
  bool force_measured = true;                             ///< false: nothing is known of `up`
  double rate = 0;                                        ///< rad/s, by the scans
  Eigen::Vector3d rate_error = Eigen::Vector3d::Zero();   ///< rad/s, body frame: measured less scans
  Eigen::Vector3d force = Eigen::Vector3d::Zero();        ///< m/s^2: mean specific force, ...
  Eigen::Vector3d force_way = Eigen::Vector3d::Zero();    ///< m: ... and how far it alone would have carried from rest
  Eigen::Vector3d up = Eigen::Vector3d::Zero();           ///< m/s^2: specific force less the scans' acceleration
  Eigen::Vector3d expected_up = Eigen::Vector3d::Zero();  ///< m/s^2: by the filter, what both should differ by
  double speed_deviation = 0;  ///< m/s: of the scans' velocity, as far as their times are to blame
};

/// Watches how an IMU agrees with the scans, its gyroscope and its accelerometer apart.
///
/// Single scans may contradict a prediction for a pothole's sake. A sensor that does so again and again, or whose mean
/// error is larger than any bias, is excluded until it has agreed with the scans for a while.
class ImuMonitor {
 public:
  explicit ImuMonitor(const ImuMonitorOptions& options = {}) : options_(options) {}  ///< uses the whole IMU at first

  /// What the next prediction may use.
  [[nodiscard]] ImuUse use() const {
    if (gyroscope_.doubted) return ImuUse::none;
    return accelerometer_.doubted ? ImuUse::gyroscope : ImuUse::all;
  }
  /// Of about the last second: rad/s in the body frame, m/s^2 in odom.
  [[nodiscard]] const Eigen::Vector3d& rate_error() const { return mean_rate_error_; }
  /// Mean difference of measured and expected acceleration, m/s^2, odom frame.
  [[nodiscard]] const Eigen::Vector3d& accel_error() const { return mean_accel_error_; }
  /// Whether it ever rejects anything.
  [[nodiscard]] bool enabled() const { return std::isfinite(options_.max_pose_nis); }
  [[nodiscard]] double max_pose_nis() const { return options_.max_pose_nis; }  ///< the bound of the options

  /// Whether a scan that lies off its prediction is the one that is wrong: its time, or its registration. After that
  /// scans lie as predicted or back; a sensor that fails goes on to lead the other way.
  /// @param off  metres, odom.
  [[nodiscard]] bool blames_scan(const Eigen::Vector3d& off) const {
    return may_blame_scans() && off.norm() >= options_.odd_distance && !(last_odd_.dot(off) > 0);
  }
  /// Whether few enough were wrong lately.
  [[nodiscard]] bool may_blame_scans() const { return odd_scans_ < options_.max_odd_scans; }
  /// Takes by how much a scan was such an odd one; zero if it was not.
  void count_odd(const Eigen::Vector3d& off) {
    odd_scans_ = options_.fading * odd_scans_ + (off.norm() > 0 ? 1 : 0);
    last_odd_ = off;
  }
  /// Takes what a scan could be predicted from, and what was measured on the way to it.
  void follow(ImuUse used, const ImuComparison& comparison);
  /// Whether all is used from now on, but was not before. Gravity's direction is then `up()`.
  [[nodiscard]] bool back_to_all() const { return back_to_all_; }
  [[nodiscard]] S2d up() const { return S2d::from_vector(mean_up_); }  ///< mean direction against gravity, odom frame

 private:
  struct Sensor {
    bool doubted = false;
    double contradictions = 0;
    double agreed = 0;  ///< seconds
    double trial = 0;   ///< seconds, before it is used again

    void judge(bool contradicted, double error, double interval, const ImuMonitorOptions& options);
  };

  static void smooth(Eigen::Vector3d& mean, const Eigen::Vector3d& value, double share);
  void compare(const ImuComparison& comparison);

  ImuMonitorOptions options_;
  Sensor gyroscope_, accelerometer_;
  Eigen::Vector3d mean_rate_error_ = Eigen::Vector3d::Zero(), mean_accel_error_ = Eigen::Vector3d::Zero();
  Eigen::Vector3d mean_up_ = Eigen::Vector3d::Zero();
  double mean_rate_ = 0, up_time_ = 0, odd_scans_ = 0;
  Eigen::Vector3d last_odd_ = Eigen::Vector3d::Zero();
  bool back_to_all_ = false;
};

/// @param error  the mean error over the greatest allowed.
inline void ImuMonitor::Sensor::judge(bool contradicted, double error, double interval,
                                      const ImuMonitorOptions& options) {
  contradictions = options.fading * contradictions + (contradicted ? 1 : 0);
  const bool bad = contradictions >= options.max_contradictions || error > 1;
  agreed = bad || contradicted || error > 0.5 ? 0 : agreed + interval;
  if (doubted && agreed >= trial) {
    doubted = false;
    contradictions = 0;
  } else if (!doubted && bad) {
    doubted = true;
    trial = trial == 0 ? options.trial : std::min(2 * trial, options.max_trial);
  }
}

inline void ImuMonitor::smooth(Eigen::Vector3d& mean, const Eigen::Vector3d& value, double share) {
  mean = sum_of(mean, scaled(std::min(1.0, share), difference_of(value, mean)));
}

inline void ImuMonitor::compare(const ImuComparison& comparison) {
  const double dt = comparison.interval;
  smooth(mean_rate_error_, comparison.rate_error, dt / options_.memory);
  mean_rate_ += std::min(1.0, dt / options_.memory) * (comparison.rate - mean_rate_);
  if (!comparison.force_measured) return;
  up_time_ += dt;
  smooth(mean_up_, comparison.up, dt / std::min(options_.up_memory, up_time_));
  const Eigen::Vector3d expected = accelerometer_.doubted ? mean_up_ : comparison.expected_up;
  smooth(mean_accel_error_, difference_of(comparison.up, expected), dt / options_.memory);
}

inline void ImuMonitor::follow(ImuUse used, const ImuComparison& comparison) {
  back_to_all_ = false;
  if (!enabled()) return;
  if (comparison.interval > 0) compare(comparison);
  const ImuUse before = use();
  const double max_rate_error = options_.max_rate_error + options_.max_rate_share * mean_rate_;
  gyroscope_.judge(used > ImuUse::gyroscope && before < ImuUse::none, mean_rate_error_.norm() / max_rate_error,
                   comparison.interval, options_);
  // Velocities that are off by chance at both ends of the time that is averaged over.
  const double by_chance = 3 * comparison.speed_deviation / options_.memory;
  accelerometer_.judge(used == ImuUse::gyroscope && before == ImuUse::all,
                       mean_accel_error_.norm() / std::hypot(options_.max_accel_error, by_chance), comparison.interval,
                       options_);
  back_to_all_ = before != ImuUse::all && use() == ImuUse::all && up_time_ > 0;
}

}  // namespace chainslam::detail
