#include "datasets/imu_findings.hpp"

#include <cstdint>

namespace chainslam::datasets {

std::vector<std::string> imu_findings(const ImuCheckCounts& counts) {
  std::vector<std::string> findings;
  const auto say = [&](std::int64_t count, const char* what) {
    if (count > 0) findings.push_back(std::to_string(count) + " IMU samples " + what);
  };
  say(counts.from_g, "converted: their acceleration is in g");
  say(counts.from_degrees, "converted: their rates are in deg/s");
  say(counts.not_finite, "rejected: NaN or infinite");
  say(counts.out_of_range, "rejected: beyond what any IMU measures");
  say(counts.spikes, "rejected: isolated spikes");
  say(counts.repeated, "rejected: they repeat the one before");
  say(counts.out_of_order, "rejected: not later than the one before");
  say(counts.invalid_times, "rejected: their times disagree with those around them");
  say(counts.second_imu, "rejected: of a second IMU, whose rows alternate with the first's");
  say(counts.stuck_gyro, "without rates: an axis of the gyroscope is stuck");
  say(counts.stuck_accel, "without acceleration: an axis of the accelerometer is stuck");
  return findings;
}

}  // namespace chainslam::datasets
