#pragma once

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/timestamp.hpp"

namespace chainslam {

/// One sweep of a LiDAR, in its own frame (`lidar`).
///
/// `cloud.time_offsets`, where present, are seconds from `time`, ascending or not, and lie within [0, end - time].
/// Where absent, the scan is a snapshot taken at `time` (already corrected for motion), and `end == time`.
struct LidarScan {
  Timestamp time{};           ///< of the first measurement, or of the snapshot
  Timestamp end{};            ///< of the last measurement
  PointCloud<float> cloud{};  ///< in the LiDAR's frame, metres
};

}  // namespace chainslam
