#include "simulator/inertial_unit.hpp"

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
          .g_sensitivity = 0.0,
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
  std::vector<ImuSample> samples;
  const auto count = static_cast<Index>(drive.duration() * options.rate);
  for (Index i = 0; i <= count; ++i) {
    const Duration time = seconds(i / options.rate);
    const Motion motion = drive.motion(to_seconds(time));
    const Eigen::Vector3d force_map = motion.acceleration_map + gravity * Eigen::Vector3d::UnitZ();
    const Eigen::Vector3d force_body = motion.T_map_body.rotation().inverse() * force_map;
    samples.push_back({.time = epoch + time,
                       .gyro = saturated(gyro.measure(motion.rate_body + pull * force_body), options.gyro_range),
                       .accel = saturated(accel.measure(force_body), options.accel_range)});
  }
  return samples;
}

}  // namespace chainslam::simulator
