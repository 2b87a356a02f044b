#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/odometry/deskew.hpp"
#include "chainslam/odometry/detail/accel_noise.hpp"
#include "chainslam/odometry/detail/imu_comparison.hpp"
#include "chainslam/odometry/detail/imu_monitor.hpp"
#include "chainslam/odometry/detail/imu_record.hpp"
#include "chainslam/odometry/detail/mounting.hpp"
#include "chainslam/odometry/ieskf.hpp"
#include "chainslam/odometry/imu_alignment.hpp"
#include "chainslam/odometry/imu_process.hpp"
#include "chainslam/odometry/inertial_motion_options.hpp"
#include "chainslam/sensor/frame.hpp"

namespace chainslam::detail {

/// The filter's motion between scans: integrates the IMU, or continues the motion where that is silent, and
/// remembers the way, for scans to be undistorted by.
class InertialMotion {
 public:
  using Filter = Ieskf<InertialState, ImuProcess>;  ///< the filter of the state
  /// @param T_body_lidar  extrinsic calibration.
  explicit InertialMotion(const InertialMotionOptions& options = {}, const SE3d& T_body_lidar = {})
      : options_(options), T_body_lidar_(T_body_lidar), imu_(options.imu), accel_noise_(options.accel_noise) {}
  /// Takes an IMU sample; see `ImuRecord::add`.
  ImuRecord::Taken add(const ImuSample& sample) {
    const ImuRecord::Taken taken = imu_.add(sample);
    imu_.forget_old();
    return taken;
  }

  /// Corrects samples from now on, and those that are kept.
  void correct(const ImuCorrection& correction) { imu_.correct(correction); }

  /// Begins at the origin, at `time`, with +z against gravity as far as the IMU observes it.
  ImuStart start(Timestamp time);
  /// Moves the filter on to `time`, which must be later than where it is.
  void predict(Timestamp time, ImuUse use = ImuUse::all) {
    before_ = filter_;
    begin_ = time_;
    imu_.forget_before(begin_);
    integrate(time, use);
  }
  /// The last prediction once more, with less of the IMU. What is not may have been wrong for a while: biases and
  /// gravity, which the filter has learnt from it, become as uncertain as at the start.
  void predict_again(ImuUse use);
  /// The last prediction once more as it was first, with as much of the IMU as then.
  void restore(ImuUse use) {
    const Timestamp time = time_;
    filter_ = before_;
    time_ = begin_;
    integrate(time, use);
  }
  /// What the last prediction used.
  [[nodiscard]] ImuUse use() const { return use_; }
  /// Assumes that the body stood still at the beginning of the interval: for a start with quiet measurements that the
  /// scan does not contradict. Then the specific force was gravity.
  void assume_rest() {
    set_translation(state().get<Inertial::velocity>(), options_.rest_speed, options_.rest_speed * interval());
    InertialState::Jacobian covariance = filter_.covariance();
    separate<Inertial::up>(covariance, options_.rest_up);
    filter_.reset(state(), covariance);
  }
  /// Leaves pose and velocity to the scan: where it lies elsewhere, the velocity was another all the way.
  void doubt_motion() {
    constexpr int p = inertial_offset<Inertial::position>, v = inertial_offset<Inertial::velocity>;
    InertialState::Jacobian covariance = filter_.covariance();
    raise_to<Inertial::rotation>(covariance, options_.lost_rotation);
    const double variance = options_.lost_position * options_.lost_position, dt = std::max(interval(), 1e-2);
    for (int i = 0; i < 3; ++i) {
      covariance(p + i, p + i) += variance;
      covariance(v + i, v + i) += variance / (dt * dt);
      covariance(p + i, v + i) += variance / dt;
      covariance(v + i, p + i) += variance / dt;
    }
    filter_.reset(filter_.state(), covariance);
  }
  /// Leaves the pose to the scan, but not the velocity: it is an odd scan, the next one is not.
  void doubt_place() {
    InertialState::Jacobian covariance = filter_.covariance();
    raise_to<Inertial::position>(covariance, options_.odd_position);
    raise_to<Inertial::rotation>(covariance, options_.odd_rotation);
    filter_.reset(filter_.state(), covariance);
  }
  /// Whether scans had observed the velocity before the prediction.
  [[nodiscard]] bool knew_velocity() const { return knows_velocity(before_.covariance()); }
  /// The predicted state with the body moved by a tangent of its pose, and as much faster or slower.
  [[nodiscard]] InertialState moved(const Vector6d& step) const {
    InertialState x = state();
    const SE3d T = T_odom_body(x) * SE3d::exp(step);
    const Eigen::Vector3d change = difference_of(T.translation(), x.get<Inertial::position>().value());
    const Eigen::Vector3d velocity = x.get<Inertial::velocity>().value();
    x.get<Inertial::position>() = R3d(T.translation());
    x.get<Inertial::rotation>() = T.rotation();
    x.get<Inertial::velocity>() = R3d(sum_of(velocity, divided(change, std::max(interval(), 1e-3))));
    return x;
  }
  /// What was measured on the way, against the state; interval 0 if not all was, or the velocity is not known.
  [[nodiscard]] ImuComparison comparison() const {
    if (!knew_velocity() || !knows_velocity(filter_.covariance())) return {};
    return detail::compare_imu(imu_, begin_, before_.state(), time_, state(), options_.process.gravity);
  }
  /// What is learnt of the accelerometer's noise: it takes what follows from each scan.
  [[nodiscard]] AccelNoise& learned_noise() { return accel_noise_; }
  /// m/s^2 per sqrt(Hz): density of the accelerometer's noise that predictions take.
  [[nodiscard]] double accel_noise() const { return std::max(options_.process.noise.accel, accel_noise_.density()); }
  /// Resets what was estimated from measurements that are no longer used.
  void forget_biases(ImuUse use) {
    if (use == ImuUse::none) hold_mounting();
    InertialState x = state();
    InertialState::Jacobian covariance = filter_.covariance();
    if (use == ImuUse::none) {
      x.get<Inertial::gyro_bias>() = R3d();
      separate<Inertial::gyro_bias>(covariance, options_.start_gyro_bias);
    }
    x.get<Inertial::accel_bias>() = R3d();
    separate<Inertial::accel_bias>(covariance, options_.start_accel_bias);
    separate<Inertial::up>(covariance, options_.start_up);
    filter_.reset(x, covariance);
  }
  /// Takes gravity's direction from elsewhere.
  void set_up(const S2d& up) {
    InertialState x = state();
    InertialState::Jacobian covariance = filter_.covariance();
    x.get<Inertial::up>() = up;
    separate<Inertial::up>(covariance, options_.start_up);
    filter_.reset(x, covariance);
  }
  /// An extrinsic calibration estimated farther off the given one than allowed is discarded, and fixed from then on.
  /// The LiDAR stays where it is. @returns whether it was.
  bool bound_mounting(double max_position, double max_rotation);
  /// The extrinsic calibration is the given one from now on, known as such: without the gyroscope it is unobservable.
  void hold_mounting();
  /// The extrinsic calibration is as uncertain as at the start, or as the axes are.
  void doubt_mounting();
  /// The body's axes are others from now on, known to `deviation` (rad) about each.
  void set_axes_deviation(double deviation) { mounting_deviation_ = std::max(options_.lidar_rotation, deviation); }
  /// Information on the calibration's rotation measured since then, about the given one; nothing while it is held.
  [[nodiscard]] RotationEvidence mounting_evidence() const;
  /// Passes the mean rate of the last interval, which is continued where there are no measurements. To be called once
  /// the pose at the end is final.
  void follow();

  /// The motion during a sweep that ends at `time()`, from the motion up to there. `correction`, a tangent of the pose
  /// at the end of the way, is spread over the way.
  [[nodiscard]] SweepMotion sweep_motion(Timestamp begin, const Vector6d& correction) const;

  /// The twist at the begin of the way, per second, body frame, had the body moved on evenly but for a correction.
  /// @param velocity_change  m/s, odom frame. @param rate_change  rad/s, body frame.
  [[nodiscard]] Vector6d twist_at_begin(const Eigen::Vector3d& velocity_change,
                                        const Eigen::Vector3d& rate_change) const {
    const Knot& knot = way_.front();
    Vector6d twist = zeros<Vector6d>();
    set_block(twist, 0, 0, knot.T_odom_body.rotation().inverse() * sum_of(knot.velocity, velocity_change));
    set_block(twist, 3, 0, sum_of(knot.rate, rate_change));
    return twist;
  }
  /// The pose at the begin of the way from the last scan to this.
  [[nodiscard]] const SE3d& way_begin() const { return way_.front().T_odom_body; }
  /// rad/s, body frame, at the end of the way.
  [[nodiscard]] Eigen::Vector3d end_rate() const { return way_.empty() ? zeros<Eigen::Vector3d>() : way_.back().rate; }
  /// rad/s, body frame, between the last two scans.
  [[nodiscard]] const Eigen::Vector3d& mean_rate() const { return mean_rate_; }
  /// Seconds of the way from the last scan to this.
  [[nodiscard]] double interval() const { return way_.empty() ? 0.0 : to_seconds(time_ - way_.front().time); }

  [[nodiscard]] Filter& filter() { return filter_; }                            ///< the filter
  [[nodiscard]] const Filter& filter() const { return filter_; }                ///< the filter
  [[nodiscard]] const InertialState& state() const { return filter_.state(); }  ///< the estimate at `time()`
  [[nodiscard]] Timestamp time() const { return time_; }                        ///< of the estimate
  [[nodiscard]] bool started() const { return started_; }                       ///< whether `start` was called
  [[nodiscard]] const ImuRecord& imu() const { return imu_; }                   ///< the IMU's samples
  /// Share of the last interval for which there were measurements.
  [[nodiscard]] double measured_share() const { return measured_share_; }

 private:
  /// The body's motion from some time on, until the next.
  struct Knot {
    Timestamp time;
    SE3d T_odom_body;
    Eigen::Vector3d velocity, acceleration;  ///< odom
    Eigen::Vector3d rate;                    ///< body

    [[nodiscard]] SE3d pose(double dt) const {
      const Eigen::Vector3d mean_velocity = sum_of(velocity, scaled(0.5 * dt, acceleration));
      return SE3d(T_odom_body.rotation() * SO3d::exp(scaled(dt, rate)),
                  sum_of(T_odom_body.translation(), scaled(dt, mean_velocity)));
    }
  };

  [[nodiscard]] SE3d way_at(Timestamp time) const {
    const auto later =
        std::upper_bound(way_.begin(), way_.end(), time, [](Timestamp t, const Knot& knot) { return t < knot.time; });
    const Knot& knot = later == way_.begin() ? way_.front() : *(later - 1);
    return knot.pose(to_seconds(time - knot.time));
  }
  /// What leaves rate and velocity as they are.
  [[nodiscard]] ImuInput continued() const {
    return {.gyro = mean_rate_,
            .gyro_noise = options_.free_gyro,
            .accel_noise = options_.free_accel,
            .rate_measured = false,
            .force_measured = false};
  }
  /// What of a measurement is used.
  [[nodiscard]] ImuInput believed(ImuInput reading, ImuUse use) const {
    if (use == ImuUse::none) return continued();
    if (!reading.rate_measured) {  // an axis is stuck
      reading.gyro = mean_rate_;
      reading.gyro_noise = options_.free_gyro;
    }
    if (!reading.force_measured) reading.accel_noise = options_.free_accel;
    const double excess = accel_noise_.excess_over(options_.process.noise.accel);
    reading.accel_noise = std::sqrt(reading.accel_noise * reading.accel_noise + excess * excess);
    if (use == ImuUse::all) return reading;
    if (use == ImuUse::rough_gyroscope) reading.gyro_noise = options_.free_gyro;
    reading.accel_noise = options_.free_accel;
    reading.force_measured = false;
    return reading;
  }
  void integrate(Timestamp time, ImuUse use);
  void step(const ImuInput& input, double dt);
  void forget_velocity();
  /// Velocity and position of their own, correlated with nothing.
  void set_translation(const R3d& velocity, double speed_deviation, double position_deviation);

  InertialMotionOptions options_;
  SE3d T_body_lidar_;
  ImuRecord imu_;
  AccelNoise accel_noise_;
  Filter filter_;
  bool started_ = false;
  Timestamp time_;
  Filter before_;    ///< before the last prediction, ...
  Timestamp begin_;  ///< and its time
  ImuUse use_ = ImuUse::all;
  std::vector<Knot> way_;                                 ///< from the last scan to this
  Eigen::Vector3d mean_rate_ = zeros<Eigen::Vector3d>();  ///< rad/s, body frame, between the last two scans
  double measured_share_ = 0;
  Index followed_ = 0;
  double mounting_deviation_ = options_.lidar_rotation;  ///< rad about each axis, while it is estimated again
};

inline ImuStart InertialMotion::start(Timestamp time) {
  const ImuStart start = options_.initializer.estimate(imu_.samples());
  InertialState x;
  x.get<Inertial::rotation>() = gravity_aligned(start.up_body);
  // Quiet measurements are of rest or of a slow, steady turn, and do not tell which. At rest their mean is the bias; in
  // a turn it says nothing of it. The state is the mean of both.
  const double rest = start.at_rest ? options_.rest_share : 0.0;
  x.get<Inertial::gyro_bias>() = R3d(scaled(rest, start.gyro_bias));
  x.get<Inertial::lidar_position>() = R3d(T_body_lidar_.translation());
  x.get<Inertial::lidar_rotation>() = T_body_lidar_.rotation();
  // The pose is the frame's own definition. What is not known of gravity is its direction in that frame.
  InertialState::Jacobian covariance = zeros<InertialState::Jacobian>();
  const auto set = [&]<Inertial::Part Part>(double deviation) {
    for (int i = 0; i < InertialState::Part<Part>::dof; ++i)
      covariance(inertial_offset<Part> + i, inertial_offset<Part> + i) = deviation * deviation;
  };
  set.operator()<Inertial::velocity>(options_.start_speed);
  set.operator()<Inertial::gyro_bias>(options_.start_gyro_bias * std::sqrt(rest * 0.2 * 0.2 + 1 - rest));
  set.operator()<Inertial::accel_bias>(options_.start_accel_bias);
  set.operator()<Inertial::bend>(options_.start_curvature);
  set.operator()<Inertial::up>(options_.start_up);
  constexpr int bias = inertial_offset<Inertial::gyro_bias>;
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i)
      covariance(bias + i, bias + j) += rest * (1 - rest) * start.gyro_bias[i] * start.gyro_bias[j];
  filter_ = Filter(x, covariance, options_.process);
  time_ = time;
  started_ = true;
  const auto none = zeros<Eigen::Vector3d>();
  way_ = {{time, T_odom_body(x), none, none, none}};
  return start;
}

inline void InertialMotion::step(const ImuInput& input, double dt) {
  const InertialState x = state();
  filter_.predict(input, dt);
  const Eigen::Vector3d velocity = x.get<Inertial::velocity>().value();
  const Eigen::Vector3d gained = difference_of(state().get<Inertial::velocity>().value(), velocity);
  way_.push_back({time_, T_odom_body(x), velocity, divided(gained, dt), input.rate(x)});
  time_ = time_ + seconds(dt);
}

inline void InertialMotion::integrate(Timestamp time, ImuUse use) {
  way_.clear();
  use_ = use;
  const Timestamp begin = time_;
  double measured = 0, free = 0;
  imu_.for_each_step(begin, time, [&](const ImuStep& piece) {
    if (piece.reading) {
      if (use != ImuUse::none && piece.reading->rate_measured) measured += piece.duration;
      free = 0;
      return step(believed(*piece.reading, use), piece.duration);
    }
    free += piece.duration;
    if (free <= options_.max_free) return step(continued(), piece.duration);
    time_ = time_ + seconds(piece.duration);
  });
  if (free > options_.max_free) forget_velocity();
  time_ = time;  // whatever rounding has done to the sum of the steps
  measured_share_ = measured / to_seconds(time - begin);
}

inline void InertialMotion::predict_again(ImuUse use) {
  InertialState::Jacobian covariance = before_.covariance();
  raise_to<Inertial::accel_bias>(covariance, options_.start_accel_bias);
  raise_to<Inertial::up>(covariance, options_.start_up);
  if (use >= ImuUse::rough_gyroscope) raise_to<Inertial::gyro_bias>(covariance, options_.start_gyro_bias);
  const Timestamp time = time_;
  filter_.reset(before_.state(), covariance);
  time_ = begin_;
  integrate(time, use);
}

/// After a long silence the body may stand, drive or have been carried: its attitude is kept, with a larger covariance.
/// Its position error shows how fast it was, and that about how fast it is.
inline void InertialMotion::forget_velocity() {
  const SE3d begin = T_odom_body(before_.state()), end = T_odom_body(state());
  const double dt = to_seconds(time_ - begin_);
  const Eigen::Vector3d velocity = divided(difference_of(end.translation(), begin.translation()), dt);
  const Eigen::Vector3d rate = divided(begin.rotation().local(end.rotation()), dt);
  way_ = {{begin_, begin, velocity, zeros<Eigen::Vector3d>(), rate}};
  const double on_the_way = options_.start_speed * options_.start_speed;
  const double since = options_.free_accel * options_.free_accel * dt;
  set_translation(R3d(velocity), std::sqrt(on_the_way + since),
                  std::sqrt(options_.lost_position * options_.lost_position + dt * dt * on_the_way));
  InertialState::Jacobian covariance = filter_.covariance();
  for (int i = 0; i < 3; ++i) {
    const int p = inertial_offset<Inertial::position> + i, v = inertial_offset<Inertial::velocity> + i;
    covariance(p, v) = covariance(v, p) = dt * on_the_way;
  }
  filter_.reset(state(), covariance);
  mean_rate_ = zeros<Eigen::Vector3d>();
}

inline void InertialMotion::set_translation(const R3d& velocity, double speed_deviation, double position_deviation) {
  InertialState x = state();
  x.get<Inertial::velocity>() = velocity;
  InertialState::Jacobian covariance = filter_.covariance();
  separate<Inertial::velocity>(covariance, speed_deviation);
  separate<Inertial::position>(covariance, position_deviation);
  filter_.reset(x, covariance);
}

inline void InertialMotion::follow() {
  if (!(interval() > 0)) return;
  const InertialState begin = detail::remounted(before_.state(), T_body_lidar(state()));
  mean_rate_ = divided(begin.get<Inertial::rotation>().local(state().get<Inertial::rotation>()), interval());
  if (++followed_ == options_.mounting_after) doubt_mounting();
}

inline void InertialMotion::doubt_mounting() {
  InertialState::Jacobian covariance = filter_.covariance();
  detail::doubt_mounting(covariance, state(), options_.lidar_position, mounting_deviation_);
  filter_.reset(state(), covariance);
}

inline void InertialMotion::hold_mounting() {
  InertialState::Jacobian covariance = filter_.covariance();
  separate<Inertial::lidar_position>(covariance, 0);
  separate<Inertial::lidar_rotation>(covariance, 0);
  filter_.reset(detail::remounted(state(), T_body_lidar_), covariance);
}

inline RotationEvidence InertialMotion::mounting_evidence() const {
  return detail::mounting_evidence(state(), filter_.covariance(), T_body_lidar_.rotation(), mounting_deviation_);
}

inline bool InertialMotion::bound_mounting(double max_position, double max_rotation) {
  const Vector6d off = T_body_lidar_.local(T_body_lidar(state()));
  if (block_of<3, 1>(off, 0, 0).norm() <= max_position && block_of<3, 1>(off, 3, 0).norm() <= max_rotation)
    return false;
  hold_mounting();
  return true;
}

inline SweepMotion InertialMotion::sweep_motion(Timestamp begin, const Vector6d& correction) const {
  const double duration = to_seconds(time_ - begin);
  if (way_.empty() || !(duration > 0)) return SweepMotion::constant_twist(std::max(duration, 0.0), zeros<Vector6d>());
  const double length = interval();
  const SE3d T_end_odom = (way_at(time_) * SE3d::exp(correction)).inverse();
  const double angle = way_at(begin).rotation().local(way_at(time_).rotation()).norm();
  return SweepMotion::sample(duration, angle, [&](double offset) {
    const Timestamp t = begin + seconds(offset);
    const double share = length > 0 ? 1 - to_seconds(time_ - t) / length : 1.0;
    return T_end_odom * way_at(t) * SE3d::exp(scaled(share, correction));
  });
}

}  // namespace chainslam::detail
