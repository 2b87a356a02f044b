#pragma once

#include <cstddef>
#include <functional>
#include <optional>
#include <span>
#include <utility>

#include "chainslam/sensor/imu_units.hpp"
#include "chainslam/sensor/packet.hpp"
#include "datasets/dataset.hpp"

namespace chainslam::datasets {

/// Turns a file's IMU samples into m/s^2, rad/s and the clock of the scans.
class ImuConversion {
 public:
  /// For files whose units are known to be m/s^2 and rad/s, unless the options say otherwise.
  explicit ImuConversion(const DatasetOptions& options = {});

  /// For files of any units: infers them from `beginning`, unless the options state them, and notes what it found.
  ImuConversion(const DatasetOptions& options, std::span<const ImuSample> beginning, DatasetInfo& info);

  [[nodiscard]] ImuSample operator()(const ImuSample& sample) const {
    ImuSample converted = units_.converted(sample);
    converted.time = converted.time + time_offset_;
    return converted;
  }

 private:
  ImuUnits units_;
  Duration time_offset_;
};

/// Samples without those whose time is ahead of the next one's: a row with a wrong time would otherwise hold back all
/// rows after it. @param read  gives the samples of a file in their order.
class TimesThatRunOn {
 public:
  explicit TimesThatRunOn(std::function<std::optional<ImuSample>()> read) : read_(std::move(read)) {}

  [[nodiscard]] std::optional<ImuSample> next();
  [[nodiscard]] std::size_t dropped() const { return dropped_; }

 private:
  std::function<std::optional<ImuSample>()> read_;
  std::optional<ImuSample> ahead_;
  std::optional<Timestamp> last_;
  std::size_t dropped_ = 0;
};

}  // namespace chainslam::datasets
