#pragma once

#include <cstdint>

#include "chainslam/odometry/scan_filter.hpp"
#include "chainslam/sensor/imu_check.hpp"

namespace chainslam {

/// What became of the input so far.
struct LidarOdometryCounts {
  ScanFilterCounts points{};            ///< points of the scans
  std::int64_t scans = 0;               ///< given
  std::int64_t frames = 0;              ///< answered
  std::int64_t empty_scans = 0;         ///< too few usable points: no frame
  std::int64_t out_of_order_scans = 0;  ///< not later than the frame before, or ending before they begin: no frame
  std::int64_t gaps = 0;                ///< pauses too long to extrapolate the motion
  std::int64_t degenerate_scans = 0;    ///< frames with status degenerate
  std::int64_t lost_scans = 0;          ///< frames with status lost
  std::int64_t map_restarts = 0;        ///< the local map was reset
  std::int64_t gyro_scans = 0;          ///< frames whose rotation was predicted by the gyroscope
  ImuCheckCounts imu{};                 ///< samples rejected, by kind
};

/// The same of `LidarInertialOdometry`.
struct LidarInertialOdometryCounts : LidarOdometryCounts {
  std::int64_t imu_restarts = 0;           ///< jumps of the IMU's clock back in time
  std::int64_t clipped_imu_samples = 0;    ///< measurements at the end of their range
  std::int64_t unmeasured_scans = 0;       ///< frames to which, for half of the way or more, there were no measurements
  std::int64_t doubted_accelerations = 0;  ///< frames whose scan contradicted the accelerometer, ...
  std::int64_t doubted_rates = 0;          ///< ... and the gyroscope
  std::int64_t evicted_points = 0;         ///< gone from the local map because there were too many
  std::int64_t mounting_resets = 0;  ///< estimates of the extrinsic calibration that went too far and were discarded
};

}  // namespace chainslam
