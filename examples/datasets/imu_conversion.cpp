#include "datasets/imu_conversion.hpp"

namespace chainslam::datasets {
namespace {

ImuUnits units_of(ImuUnitsGiven given) {
  ImuUnits units;
  if (given == ImuUnitsGiven::automatic) return units;
  const bool g = given == ImuUnitsGiven::g || given == ImuUnitsGiven::g_and_degrees;
  const bool degrees = given == ImuUnitsGiven::degrees || given == ImuUnitsGiven::g_and_degrees;
  units.accel = g ? AccelUnit::g : AccelUnit::metres_per_second_squared;
  units.gyro = degrees ? GyroUnit::degrees_per_second : GyroUnit::radians_per_second;
  return units;
}

}  // namespace

ImuConversion::ImuConversion(const DatasetOptions& options)
    : units_(units_of(options.imu_units)), time_offset_(options.imu_time_offset) {}

ImuConversion::ImuConversion(const DatasetOptions& options, std::span<const ImuSample> beginning, DatasetInfo& info)
    : ImuConversion(options) {
  if (options.imu_units == ImuUnitsGiven::automatic) units_ = infer_imu_units(beginning);
  if (units_.accel == AccelUnit::g) info.notes.emplace_back("acceleration in g: turned into m/s^2");
  if (units_.gyro == GyroUnit::degrees_per_second) info.notes.emplace_back("rates in deg/s: turned into rad/s");
}

std::optional<ImuSample> TimesThatRunOn::next() {
  if (!ahead_) ahead_ = read_();
  while (ahead_) {
    const ImuSample sample = *ahead_;
    ahead_ = read_();
    const bool ahead_of_next = ahead_ && sample.time > ahead_->time && (!last_ || ahead_->time > *last_);
    if (ahead_of_next) {
      ++dropped_;
      continue;
    }
    last_ = sample.time;
    return sample;
  }
  return std::nullopt;
}

}  // namespace chainslam::datasets
