#include "imu_clock.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace chainslam::support {

namespace {

/// What was found must be applied as well, which waits for axes that are wrong and for an offset to be significant;
/// odometry leaves 10 ms uncorrected for good.
bool is_known(const std::optional<ImuCalibration>& calibration) {
  constexpr double left = 0.01;  // seconds
  return calibration && calibration->found.time_known &&
         std::abs(calibration->found.time_offset - calibration->applied.time_offset) <= left;
}

}  // namespace

std::optional<double> ImuClock::follow(Timestamp scan, const std::optional<ImuCalibration>& calibration) {
  const double longest_wait =
      calibration ? 120 : 5;  // seconds; an IMU's first measurement may come after the first scan
  const double most = first_ ? 0.5 * to_seconds(scan - scan_) : 0.0;
  scan_ = scan;
  if (calibration) offset_ = -calibration->applied_time_offset();
  if (!first_) {
    first_ = scan;
    if (settled_) shift_ = offset_;
  }
  if (!settled_) return is_known(calibration) || to_seconds(scan - *first_) > longest_wait ? settle() : std::nullopt;
  shift_ += std::clamp(offset_ - shift_, -most, most);
  return std::nullopt;
}

std::optional<double> ImuClock::end() { return settle(); }

std::optional<double> ImuClock::settle() {
  if (std::exchange(settled_, true)) return std::nullopt;
  return shift_ = offset_;
}

}  // namespace chainslam::support
