#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <span>
#include <string>
#include <vector>

#include "chainslam/core/finite.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sensor/imu_sample.hpp"

namespace chainslam {

enum class AccelUnit { unknown, metres_per_second_squared, g };
enum class GyroUnit { unknown, radians_per_second, degrees_per_second };

/// Which units an inertial unit's numbers seem to have, with the figures that say so.
struct ImuUnits {
  AccelUnit accel = AccelUnit::unknown;
  GyroUnit gyro = GyroUnit::unknown;
  double median_accel = 0;  ///< of the norm, in the data's own unit
  double fastest_gyro = 0;  ///< 99th percentile of the norm, in the data's own unit
  double gravity_scale =
      0;                 ///< rate of gravity's turning over the gyroscope's: 1 for rad/s, 0.0175 for deg/s; 0 if unseen
  Index used = 0;        ///< samples with finite numbers
  std::string sentence;  ///< for the log

  /// Factor to m/s^2; 1 if unknown.
  [[nodiscard]] double accel_scale() const { return accel == AccelUnit::g ? 9.80665 : 1.0; }
  /// Factor to rad/s; 1 if unknown.
  [[nodiscard]] double gyro_scale() const {
    return gyro == GyroUnit::degrees_per_second ? std::numbers::pi / 180 : 1.0;
  }
};

namespace detail {

/// Mean of a stretch of samples of at least a quarter second, so that gravity stands out of the motion.
struct ImuStretch {
  Eigen::Vector3d accel = Eigen::Vector3d::Zero();
  Eigen::Vector3d gyro = Eigen::Vector3d::Zero();
  double time = 0;  ///< seconds from the first sample, of the middle
};

inline std::vector<ImuStretch> imu_stretches(std::span<const ImuSample> samples) {
  constexpr double length = 0.25;
  std::vector<ImuStretch> stretches;
  ImuStretch sum;
  double begin = 0;
  int count = 0;
  for (const ImuSample& sample : samples) {
    if (!is_finite(sample.accel) || !is_finite(sample.gyro)) continue;
    const double time = to_seconds(sample.time - samples.front().time);
    if (count > 0 && time - begin >= length) {
      stretches.push_back({sum.accel / count, sum.gyro / count, sum.time / count});
      sum = {};
      count = 0;
    }
    if (count == 0) begin = time;
    sum.accel += sample.accel;
    sum.gyro += sample.gyro;
    sum.time += time;
    ++count;
  }
  return stretches;
}

/// A world-fixed direction seen from a body that turns at w moves by d' = d x w. The least-squares factor s in
/// d' = s (d x w), d the direction of the mean specific force, is 1 where w is in rad/s. Returns 0 where the body
/// hardly tilts: turning about the vertical says nothing.
inline double gravity_scale(std::span<const ImuStretch> stretches) {
  double measured = 0, predicted = 0, actual = 0;
  for (std::size_t i = 2; i < stretches.size(); ++i) {
    const ImuStretch &before = stretches[i - 2], &here = stretches[i - 1], &after = stretches[i];
    const double step = after.time - before.time;
    if (step <= 0 || step > 2) continue;  // a gap
    if (before.accel.norm() <= 0 || here.accel.norm() <= 0 || after.accel.norm() <= 0) continue;
    const Eigen::Vector3d change = (after.accel.normalized() - before.accel.normalized()) / step;
    const Eigen::Vector3d model = here.accel.normalized().cross(here.gyro);
    measured += change.dot(model);
    predicted += model.squaredNorm();
    actual += change.squaredNorm();
  }
  if (predicted <= 0 || actual <= 0) return 0;
  const double correlation = measured / std::sqrt(predicted * actual);
  return correlation > 0.5 ? measured / predicted : 0;
}

inline double quantile(std::vector<double> values, double q) {
  if (values.empty()) return 0;
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(q * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

}  // namespace detail

/// Infers the units of an inertial unit from a stretch of its data (some seconds; motion helps).
///
/// The accelerometer by its median norm, which gravity sets: 7 to 13 is m/s^2, 0.7 to 1.3 is g. The gyroscope by
/// gravity's own turning where the body tilts; else by its fastest rates, as no common gyroscope measures more than
/// 2000 deg/s (35 rad/s). What neither decides stays unknown. Samples with numbers that are not finite are left out.
[[nodiscard]] inline ImuUnits infer_imu_units(std::span<const ImuSample> samples) {
  ImuUnits result;
  std::vector<double> accel, gyro;
  for (const ImuSample& sample : samples) {
    if (!is_finite(sample.accel) || !is_finite(sample.gyro)) continue;
    accel.push_back(sample.accel.norm());
    gyro.push_back(sample.gyro.norm());
  }
  result.used = to_index(accel.size(), "IMU samples");
  result.median_accel = detail::quantile(std::move(accel), 0.5);
  result.fastest_gyro = detail::quantile(std::move(gyro), 0.99);
  result.gravity_scale = detail::gravity_scale(detail::imu_stretches(samples));

  if (result.median_accel > 7 && result.median_accel < 13) result.accel = AccelUnit::metres_per_second_squared;
  if (result.median_accel > 0.7 && result.median_accel < 1.3) result.accel = AccelUnit::g;
  if (result.gravity_scale > 0.3 && result.gravity_scale < 3)
    result.gyro = GyroUnit::radians_per_second;
  else if ((result.gravity_scale > 0.3 / 57.3 && result.gravity_scale < 3 / 57.3) || result.fastest_gyro > 35)
    result.gyro = GyroUnit::degrees_per_second;

  constexpr const char* accel_names[] = {"unknown (taken as m/s^2)", "m/s^2", "g"};
  constexpr const char* gyro_names[] = {"unknown (taken as rad/s)", "rad/s", "deg/s"};
  char text[256];
  std::snprintf(
      text, sizeof text,
      "IMU units: acceleration %s (median norm %.4g), rate %s (99 of 100 below %.4g, gravity turns at %.3g of it)",
      accel_names[static_cast<int>(result.accel)], result.median_accel, gyro_names[static_cast<int>(result.gyro)],
      result.fastest_gyro, result.gravity_scale);
  result.sentence = text;
  return result;
}

}  // namespace chainslam
