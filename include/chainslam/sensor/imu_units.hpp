#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <numbers>
#include <span>
#include <string>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam {

enum class AccelUnit { unknown, metres_per_second_squared, g };
enum class GyroUnit { unknown, radians_per_second, degrees_per_second };

/// Which units an IMU's numbers seem to have, with the figures that say so.
struct ImuUnits {
  AccelUnit accel = AccelUnit::unknown;  ///< of the accelerometer
  GyroUnit gyro = GyroUnit::unknown;     ///< of the gyroscope
  double median_accel = 0;               ///< of the norm, in the data's own unit
  double fastest_gyro = 0;               ///< 99th percentile of the norm, in the data's own unit
  /// Rate at which gravity turns over the gyroscope's: 1 for rad/s, 0.0175 for deg/s; 0 if unseen.
  double gravity_scale = 0;
  double gravity_bound = 0;  ///< what that can be at most, as far as gravity turns at all; 0 if unseen
  Index used = 0;            ///< samples with finite numbers
  std::string sentence;      ///< for the log

  /// Factor to m/s^2; 1 if unknown.
  [[nodiscard]] double accel_scale() const { return accel == AccelUnit::g ? 9.80665 : 1.0; }
  /// Factor to rad/s; 1 if unknown.
  [[nodiscard]] double gyro_scale() const {
    return gyro == GyroUnit::degrees_per_second ? std::numbers::pi / 180 : 1.0;
  }
  /// A sample in these units as one in m/s^2 and rad/s.
  [[nodiscard]] ImuSample converted(ImuSample sample) const {
    sample.accel = scaled(accel_scale(), sample.accel);
    sample.gyro = scaled(gyro_scale(), sample.gyro);
    return sample;
  }
};

namespace detail {

/// Mean of a stretch of samples, so that gravity stands out of the motion.
struct ImuInterval {
  Eigen::Vector3d accel = Eigen::Vector3d::Zero();
  Eigen::Vector3d gyro = Eigen::Vector3d::Zero();
  double time = 0;  ///< seconds from the first sample, of the middle
};

/// Finite samples, each axis the median of three in a row: spikes of one sample, of any size, are gone.
inline std::vector<ImuSample> without_spikes(std::span<const ImuSample> samples) {
  std::vector<ImuSample> finite;
  for (const ImuSample& sample : samples)
    if (is_finite(sample.accel) && is_finite(sample.gyro)) finite.push_back(sample);
  if (finite.size() < 3) return finite;
  const auto median = [](double a, double b, double c) {
    return std::max(std::min(a, b), std::min(std::max(a, b), c));
  };
  std::vector<ImuSample> smooth;
  for (std::size_t i = 1; i + 1 < finite.size(); ++i) {
    const ImuSample &a = finite[i - 1], &b = finite[i], &c = finite[i + 1];
    smooth.push_back(b);
    for (int axis = 0; axis < 3; ++axis) {
      smooth.back().gyro[axis] = median(a.gyro[axis], b.gyro[axis], c.gyro[axis]);
      smooth.back().accel[axis] = median(a.accel[axis], b.accel[axis], c.accel[axis]);
    }
  }
  return smooth;
}

/// @param length  seconds of a stretch, at least.
inline std::vector<ImuInterval> imu_intervals(const std::vector<ImuSample>& samples, double length) {
  std::vector<ImuInterval> stretches;
  ImuInterval sum;
  double begin = 0;
  int count = 0;
  for (const ImuSample& sample : samples) {
    const double time = to_seconds(sample.time - samples.front().time);
    if (count > 0 && time - begin >= length) {
      stretches.push_back({divided(sum.accel, count), divided(sum.gyro, count), sum.time / count});
      sum = {};
      count = 0;
    }
    if (count == 0) begin = time;
    sum.accel = sum_of(sum.accel, sample.accel);
    sum.gyro = sum_of(sum.gyro, sample.gyro);
    sum.time += time;
    ++count;
  }
  return stretches;
}

/// How fast gravity turns in the body frame, and how fast it should by the gyroscope.
struct GravityTurn {
  double scale = 0;     ///< least-squares factor between both where they agree, 0 where they do not
  double bound = 0;     ///< actual over expected rate, root mean squares: no noise makes it smaller than the factor
  double expected = 0;  ///< root mean square by the gyroscope, in its own unit
  int compared = 0;
};

/// A world-fixed direction seen from a body that turns at w moves by d' = d x w. The least-squares factor s in
/// d' = s (d x w), d the direction of the mean specific force, is 1 where w is in rad/s. Where the body hardly tilts
/// there is none: turning about the vertical says nothing. The gyroscope's mean counts as bias.
inline GravityTurn gravity_turn(const std::vector<ImuInterval>& stretches) {
  GravityTurn turn;
  Eigen::Vector3d bias = Eigen::Vector3d::Zero();
  for (const ImuInterval& stretch : stretches)
    bias = sum_of(bias, divided(stretch.gyro, static_cast<double>(stretches.size())));
  double measured = 0, predicted = 0, actual = 0;
  for (std::size_t i = 2; i < stretches.size(); ++i) {
    const ImuInterval &before = stretches[i - 2], &here = stretches[i - 1], &after = stretches[i];
    const double step = after.time - before.time;
    if (step <= 0 || step > 2) continue;  // a gap
    if (before.accel.norm() <= 0 || here.accel.norm() <= 0 || after.accel.norm() <= 0) continue;
    const auto direction = [](const ImuInterval& stretch) { return divided(stretch.accel, stretch.accel.norm()); };
    const Eigen::Vector3d change = divided(difference_of(direction(after), direction(before)), step);
    const Eigen::Vector3d model = direction(here).cross(difference_of(here.gyro, bias));
    measured += change.dot(model);
    predicted += model.squaredNorm();
    actual += change.squaredNorm();
    ++turn.compared;
  }
  if (predicted <= 0 || actual <= 0) return turn;
  const double correlation = measured / std::sqrt(predicted * actual);
  if (correlation > 0.5) turn.scale = measured / predicted;
  turn.bound = std::sqrt(actual / predicted);
  turn.expected = std::sqrt(predicted / turn.compared);
  return turn;
}

inline double quantile(std::vector<double> values, double q) {
  if (values.empty()) return 0;
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(q * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

}  // namespace detail

/// Infers the units of an IMU from a stretch of its data (some seconds; motion helps).
///
/// The accelerometer by its median norm, which gravity sets: 7 to 13 is m/s^2, 0.7 to 1.3 is g. The gyroscope by how
/// gravity turns where the body tilts: over two seconds or more at its rate, or at a 57th of its rate; over one second
/// or more by so little that the rate cannot be in rad/s. Else by its fastest rates, as no common gyroscope measures
/// more than 2000 deg/s (35 rad/s). What neither decides stays unknown. Isolated spikes and numbers that are not finite
/// do not count.
[[nodiscard]] inline ImuUnits infer_imu_units(std::span<const ImuSample> samples) {
  ImuUnits result;
  const std::vector<ImuSample> smooth = detail::without_spikes(samples);
  std::vector<double> accel, gyro;
  for (const ImuSample& sample : smooth) {
    accel.push_back(sample.accel.norm());
    gyro.push_back(sample.gyro.norm());
  }
  result.used = to_index(accel.size(), "IMU samples");
  result.median_accel = detail::quantile(std::move(accel), 0.5);
  result.fastest_gyro = detail::quantile(std::move(gyro), 0.99);
  const detail::GravityTurn turn = detail::gravity_turn(detail::imu_intervals(smooth, 0.25));
  const detail::GravityTurn quick = detail::gravity_turn(detail::imu_intervals(smooth, 0.125));
  constexpr int enough = 6;  // comparisons; fewer agree by chance
  if (turn.compared >= enough) result.gravity_scale = turn.scale;
  if (quick.compared >= enough) result.gravity_bound = quick.bound;

  if (result.median_accel > 7 && result.median_accel < 13) result.accel = AccelUnit::metres_per_second_squared;
  if (result.median_accel > 0.7 && result.median_accel < 1.3) result.accel = AccelUnit::g;
  // In rad/s the bound was above 0.69 in every second of seven real drives and three hand-held recordings. A body whose
  // specific force turns with it (a drone) keeps below the expected rate: less than half a radian per second.
  const bool impossible_in_radians = result.gravity_bound > 0 && result.gravity_bound < 0.25 && quick.expected > 0.5;
  if (result.gravity_scale > 0.3 && result.gravity_scale < 3)
    result.gyro = GyroUnit::radians_per_second;
  else if ((result.gravity_scale > 0.3 / 57.3 && result.gravity_scale < 3 / 57.3) || impossible_in_radians ||
           result.fastest_gyro > 35)
    result.gyro = GyroUnit::degrees_per_second;

  constexpr const char* accel_names[] = {"unknown (taken as m/s^2)", "m/s^2", "g"};
  constexpr const char* gyro_names[] = {"unknown (taken as rad/s)", "rad/s", "deg/s"};
  char text[256];
  std::snprintf(text, sizeof text,
                "IMU units: acceleration %s (median norm %.4g), rate %s (99 of 100 below %.4g, gravity turns at %.3g "
                "of it, at most %.3g)",
                accel_names[static_cast<int>(result.accel)], result.median_accel,
                gyro_names[static_cast<int>(result.gyro)], result.fastest_gyro, result.gravity_scale,
                result.gravity_bound);
  result.sentence = text;
  return result;
}

/// Infers the units of an IMU while its samples come: `infer_imu_units` of those so far, each time they have doubled.
///
/// The accelerometer's unit is known from the fourth sample on, the gyroscope's after a second or more in which the
/// body tilts. Memory is bounded: of faster streams a sample each 10 ms is looked at, of at most 8192; then, if a unit
/// is still unknown, again.
class ImuUnitWatch {
 public:
  /// Takes the next sample, in the IMU's own units.
  void add(const ImuSample& raw) {
    if (done_) return;
    if (!samples_.empty() && raw.time >= samples_.back().time && raw.time - samples_.back().time < spacing) return;
    samples_.push_back(raw);
    if (std::has_single_bit(samples_.size()) && samples_.size() >= (renewed_ ? settled : first)) infer();
    if (samples_.size() < capacity) return;
    done_ = units_.accel != AccelUnit::unknown && units_.gyro != GyroUnit::unknown;
    renewed_ = true;
    if (done_)
      std::vector<ImuSample>().swap(samples_);
    else
      samples_.clear();
  }

  [[nodiscard]] const ImuUnits& units() const { return units_; }  ///< as recognized so far

 private:
  static constexpr Duration spacing = std::chrono::milliseconds(10) - std::chrono::microseconds(100);  // and its jitter
  static constexpr std::size_t capacity = 8192;
  static constexpr std::size_t first = 4;     ///< samples that are looked at
  static constexpr std::size_t settled = 64;  ///< samples, from which on an earlier answer may be taken back

  void infer() {
    const ImuUnits now = infer_imu_units(samples_);
    const ImuUnits before = units_;
    const bool revise = samples_.size() >= settled;
    units_ = now;
    if (now.accel == AccelUnit::unknown || (before.accel != AccelUnit::unknown && !revise)) units_.accel = before.accel;
    if (now.gyro == GyroUnit::unknown || (before.gyro != GyroUnit::unknown && !revise)) units_.gyro = before.gyro;
  }

  ImuUnits units_;
  std::vector<ImuSample> samples_;
  bool renewed_ = false, done_ = false;
};

}  // namespace chainslam
