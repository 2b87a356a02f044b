#pragma once

#include <optional>

#include "chainslam/core/timestamp.hpp"
#include "support/imu_calibration.hpp"

namespace chainslam::support {

/// Whose clock the times of frames are on.
enum class FrameClock {
  lidar,  ///< the scans' own times
  imu,    ///< times of scans, shifted by what was found between the two clocks
};

/// Gives the frames of one session the times of the IMU's clock, as far as calibration has found it.
///
/// Whoever can wait shifts the frames of a session's start once the offset is known, so that all have the same clock.
class ImuClock {
 public:
  /// @param waits  for the offset; otherwise frames are stamped by what is known of it when they come.
  /// @param time_offset  seconds, the setting imu.time_offset: added to the IMU's stamps before all else.
  explicit ImuClock(bool waits, double time_offset = 0) : settled_(!waits), offset_(-time_offset) {}

  /// Takes the next scan's time and what is known then.
  /// @returns by how much the frames before are to be shifted, seconds, once: when the offset is known to 5 ms, or when
  /// five minutes have not shown it; without a calibration, after five seconds.
  std::optional<double> follow(Timestamp scan, const std::optional<ImuCalibration>& calibration);
  /// The data have ended. @returns the same, if it is not known to these 5 ms.
  std::optional<double> end();

  /// The time of the scan's frame. Times ascend: when the offset is corrected, the shift changes by half of the time
  /// between two scans at most.
  [[nodiscard]] Timestamp frame_time() const { return scan_ + seconds(shift_); }
  /// By how much frames are shifted, seconds.
  [[nodiscard]] double shift() const { return shift_; }

 private:
  std::optional<double> settle();

  bool settled_;
  std::optional<Timestamp> first_;
  Timestamp scan_;
  double offset_;     ///< seconds, as known now
  double shift_ = 0;  ///< of the frame at hand
};

}  // namespace chainslam::support
