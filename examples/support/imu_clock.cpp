#include "imu_clock.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace chainslam::support {

namespace {

/// What odometry leaves uncorrected for good, seconds.
constexpr double uncorrected = 0.01;

bool is_applied(const ImuCalibration& calibration) {
  return std::abs(calibration.found.time_offset - calibration.applied.time_offset) <= uncorrected;
}

/// An offset that is fitted to wrong axes is as wrong.
bool is_known(const ImuCalibration& calibration) {
  return calibration.found.time_known && (is_applied(calibration) || !calibration.found.contradicted);
}

/// By how much scans are to be shifted, by what is known: odometry corrects an offset later, when it is significant.
double shift_by(const ImuCalibration& calibration) {
  const bool ahead = is_known(calibration) && !is_applied(calibration);
  return -(ahead ? calibration.found_time_offset() : calibration.applied_time_offset());
}

}  // namespace

std::optional<double> ImuClock::follow(Timestamp scan, const std::optional<ImuCalibration>& calibration) {
  const double longest_wait =
      calibration ? 300 : 5;  // seconds; an IMU's first measurement may come after the first scan
  const double most = first_ ? 0.5 * to_seconds(scan - scan_) : 0.0;
  scan_ = scan;
  if (calibration) offset_ = shift_by(*calibration);
  if (!first_) {
    first_ = scan;
    if (settled_) shift_ = offset_;
  }
  const bool known = calibration && is_known(*calibration);
  if (!settled_) return known || to_seconds(scan - *first_) > longest_wait ? settle() : std::nullopt;
  shift_ += std::clamp(offset_ - shift_, -most, most);
  return std::nullopt;
}

std::optional<double> ImuClock::end() { return settle(); }

std::optional<double> ImuClock::settle() {
  if (std::exchange(settled_, true)) return std::nullopt;
  return shift_ = offset_;
}

}  // namespace chainslam::support
