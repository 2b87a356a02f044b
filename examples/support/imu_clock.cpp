#include "imu_clock.hpp"

#include <algorithm>
#include <utility>

namespace chainslam::support {

std::optional<double> ImuClock::follow(Timestamp scan, const std::optional<ImuCalibration>& calibration) {
  constexpr double longest_wait = 120;  // seconds
  const double most = first_ ? 0.5 * to_seconds(scan - scan_) : 0.0;
  scan_ = scan;
  if (calibration) offset_ = -calibration->applied_time_offset();
  if (!first_) {
    first_ = scan;
    if (settled_ || !calibration) shift_ = offset_;
    if (!calibration) return settle();
  }
  const bool known = calibration && calibration->found.time_known;
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
