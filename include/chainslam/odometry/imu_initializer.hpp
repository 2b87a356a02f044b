#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/so3.hpp"
#include "chainslam/sensor/imu_sample.hpp"

namespace chainslam {

/// What an IMU says of its attitude and bias before the first scan.
struct ImuStart {
  bool at_rest = false;                                 ///< the measurements were quiet enough to be a standstill
  Eigen::Vector3d gyro_bias = Eigen::Vector3d::Zero();  ///< rad/s; zero unless at rest
  Eigen::Vector3d up_body = Eigen::Vector3d::UnitZ();   ///< direction against gravity, in the body frame
  Index samples = 0;                                    ///< IMU samples that it was estimated from
};

/// Detects standstill and estimates gravity's direction and the gyroscope's bias from it.
///
/// Gravity is taken as a direction only, so accelerometers in g and in m/s^2 serve alike. In motion the mean specific
/// force still shows the vertical, to some degrees; the bias is then left at zero and `at_rest` is false.
struct ImuInitializer {
  Index min_samples = 5;              ///< fewer: no attitude, `samples` stays what it was and `up_body` is +z
  double max_gyro_deviation = 0.03;   ///< rad/s, root mean square about the mean
  double max_gyro_mean = 0.15;        ///< rad/s; a steady turn is no standstill
  double max_accel_deviation = 0.03;  ///< relative to the mean specific force

  /// @param samples  any range of `ImuSample`, in time order, all finite. Those with a stuck axis do not count.
  template <class Samples>
  [[nodiscard]] ImuStart estimate(const Samples& samples) const {
    ImuStart start;
    const auto usable = [](const ImuSample& sample) { return sample.rate_measured && sample.force_measured; };
    start.samples = to_index(std::count_if(samples.begin(), samples.end(), usable));
    if (start.samples < min_samples) return start;
    const double n = static_cast<double>(start.samples);
    Eigen::Vector3d gyro = Eigen::Vector3d::Zero();
    Eigen::Vector3d accel = Eigen::Vector3d::Zero();
    for (const ImuSample& sample : samples) {
      if (!usable(sample)) continue;
      gyro = sum_of(gyro, divided(sample.gyro, n));
      accel = sum_of(accel, divided(sample.accel, n));
    }
    double gyro_variance = 0;
    double accel_variance = 0;
    for (const ImuSample& sample : samples) {
      if (!usable(sample)) continue;
      gyro_variance += difference_of(sample.gyro, gyro).squaredNorm() / n;
      accel_variance += difference_of(sample.accel, accel).squaredNorm() / n;
    }
    const double force = accel.norm();
    if (!(force > 0)) return start;
    start.up_body = divided(accel, force);
    start.at_rest = gyro_variance <= max_gyro_deviation * max_gyro_deviation && gyro.norm() <= max_gyro_mean &&
                    accel_variance <= max_accel_deviation * max_accel_deviation * force * force;
    if (start.at_rest) start.gyro_bias = gyro;
    return start;
  }
};

/// The attitude without yaw in which `up_body` points up: the shortest rotation R_odom_body with R_odom_body * up = +z.
[[nodiscard]] inline SO3d gravity_aligned(const Eigen::Vector3d& up_body) {
  return SO3d::between(up_body, Eigen::Vector3d::UnitZ());
}

}  // namespace chainslam
