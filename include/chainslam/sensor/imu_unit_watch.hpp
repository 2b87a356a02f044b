#pragma once

#include <bit>
#include <chrono>
#include <cstddef>
#include <vector>

#include "chainslam/sensor/imu_units.hpp"

namespace chainslam {

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
