#include "simulator/inertial_unit.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "simulator/day.hpp"

namespace chainslam::simulator {

namespace {

Eigen::Vector3d normal_vector(Rng& rng, double deviation) {
  Eigen::Vector3d v;
  for (int axis = 0; axis < 3; ++axis) v[axis] = deviation * rng.normal();
  return v;
}

/// Three axes that measure (I + scale and misalignment) * truth + bias + noise, the bias a random walk.
class Triad {
 public:
  Triad(double scale, double misalignment, double bias, double walk, double noise, const Rng& unit, Index day)
      : rng_(unit), walk_(walk), noise_(noise) {
    gain_ = Eigen::Matrix3d::Identity() + SO3d::hat(normal_vector(rng_, misalignment));
    gain_.diagonal() += normal_vector(rng_, scale);
    if (day > 0) rng_ = on_day(unit, day);
    bias_ = normal_vector(rng_, bias);
  }

  Eigen::Vector3d measure(const Eigen::Vector3d& truth) {
    const Eigen::Vector3d reading = gain_ * truth + bias_ + normal_vector(rng_, noise_);
    bias_ += normal_vector(rng_, walk_);
    return reading;
  }

 private:
  Rng rng_;
  double walk_;   ///< standard deviation per sample
  double noise_;  ///< standard deviation per sample
  Eigen::Matrix3d gain_;
  Eigen::Vector3d bias_;
};

/// What shakes the unit: a tone of its own in each axis.
class Shaking {
 public:
  Shaking(double amplitude, double frequency, Rng rng) : amplitude_(amplitude) {
    for (int axis = 0; axis < 3; ++axis) {
      rate_[axis] = 2.0 * std::numbers::pi * frequency * rng.uniform(0.8, 1.2);
      phase_[axis] = rng.uniform(0.0, 2.0 * std::numbers::pi);
    }
  }

  [[nodiscard]] Eigen::Vector3d at(double time, double speed) const {
    const double size = amplitude_ * std::min(1.0, speed);
    return size * (time * rate_ + phase_).array().sin();
  }

 private:
  double amplitude_;
  Eigen::Vector3d rate_;   ///< rad/s
  Eigen::Vector3d phase_;  ///< radians
};

Eigen::Vector3d saturated(const Eigen::Vector3d& reading, double range) {
  return reading.cwiseMax(-range).cwiseMin(range);
}

}  // namespace

InertialOptions InertialOptions::without_errors() const {
  return {.rate = rate,
          .gyro_noise = 0.0,
          .accel_noise = 0.0,
          .gyro_bias = 0.0,
          .accel_bias = 0.0,
          .gyro_bias_walk = 0.0,
          .accel_bias_walk = 0.0,
          .scale = 0.0,
          .misalignment_deg = 0.0,
          .gyro_warm_up = 0.0,
          .accel_warm_up = 0.0,
          .g_sensitivity = 0.0,
          .shake_gyro = 0.0,
          .shake_accel = 0.0,
          .clock_offset = 0.0,
          .clock_jitter = 0.0,
          .gyro_range = gyro_range,
          .accel_range = accel_range};
}

std::vector<ImuSample> record_imu(const VehicleMotion& drive, const InertialOptions& options, Timestamp epoch,
                                  const Rng& unit, Index day) {
  const double misalignment = options.misalignment_deg * std::numbers::pi / 180.0;
  const double per_sample = std::sqrt(options.rate);  // white noise of a density, sampled
  Triad gyro(options.scale, misalignment, options.gyro_bias, options.gyro_bias_walk / per_sample,
             options.gyro_noise * per_sample, unit.fork(0), day);
  Triad accel(options.scale, misalignment, options.accel_bias, options.accel_bias_walk / per_sample,
              options.accel_noise * per_sample, unit.fork(1), day);
  Eigen::Matrix3d pull;  // of specific force on the gyroscopes
  Rng pull_rng = unit.fork(2);
  for (int axis = 0; axis < 3; ++axis) pull.col(axis) = normal_vector(pull_rng, options.g_sensitivity);
  Rng warming = on_day(unit.fork(3), day);
  const Eigen::Vector3d gyro_warm = normal_vector(warming, options.gyro_warm_up);
  const Eigen::Vector3d accel_warm = normal_vector(warming, options.accel_warm_up);
  const Shaking gyro_shaking(options.shake_gyro, options.shake_frequency, unit.fork(4));
  const Shaking accel_shaking(options.shake_accel, options.shake_frequency, unit.fork(5));
  Rng clock = on_day(unit.fork(6), day);
  const double jitter = std::min(options.clock_jitter, 0.45 / options.rate);
  std::vector<ImuSample> samples;
  const auto count = static_cast<Index>(drive.duration() * options.rate);
  for (Index i = 0; i <= count; ++i) {
    const Duration time = seconds(i / options.rate);
    const double true_time = to_seconds(time) + options.clock_offset + jitter * clock.uniform(-1.0, 1.0);
    const Motion motion = drive.motion(true_time);
    const double speed = motion.velocity_map.norm();
    const double warm = 1.0 - std::exp(-true_time / options.warm_up_time);
    const Eigen::Vector3d force_map = motion.acceleration_map + gravity * Eigen::Vector3d::UnitZ();
    const Eigen::Vector3d force_body =
        motion.T_map_body.rotation().inverse() * force_map + accel_shaking.at(true_time, speed);
    const Eigen::Vector3d rate_body = motion.rate_body + pull * force_body + gyro_shaking.at(true_time, speed);
    samples.push_back({.time = epoch + time,
                       .gyro = saturated(gyro.measure(rate_body) + warm * gyro_warm, options.gyro_range),
                       .accel = saturated(accel.measure(force_body) + warm * accel_warm, options.accel_range)});
  }
  return samples;
}

}  // namespace chainslam::simulator
