#pragma once

#include <optional>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/sensor/gnss_fix.hpp"
#include "chainslam/sensor/imu_use.hpp"

namespace chainslam {

/// How well odometry held on to one scan.
enum class FrameStatus { good, degenerate, lost };

/// How far a frame's pose can be relied on.
struct FrameHealth {
  FrameStatus status = FrameStatus::good;  ///< how well the scan was registered
  Index points = 0;                        ///< given to registration
  Index matches = 0;                       ///< that found a partner
  double residual_rms = 0;                 ///< metres, over matches
  Index iterations = 0;                    ///< of registration
  bool map_restarted = false;  ///< the local map was cleared, and begins with this scan at the predicted pose
  bool after_gap = false;      ///< no frame before for longer than the motion can be predicted
  /// What of the IMU the pose relies on; empty if odometry does not say.
  std::optional<ImuUse> imu_use{};
  bool imu_as_set = false;  ///< settings leave the accelerometer out: `ImuUse::gyroscope` is then no contradiction

  /// Whether the pose may be wrong by more than registration to the local map leaves.
  [[nodiscard]] bool doubtful() const {
    const bool imu_contradicted = (imu_use == ImuUse::gyroscope && !imu_as_set) || imu_use == ImuUse::rough_gyroscope;
    return status != FrameStatus::good || map_restarted || after_gap || imu_contradicted;
  }
};

/// What odometry says of one scan.
struct Frame {
  Timestamp time;                              ///< the pose holds at this time
  SE3d T_odom_body;                            ///< pose at `time`
  Matrix6d covariance = identity<Matrix6d>();  ///< of T_odom_body, tangent [translation; rotation]
  PointCloud<float> cloud;                     ///< motion-corrected to `time`, body frame
  FrameHealth health;                          ///< how far it can be relied on
  std::optional<GnssFix> gnss{};               ///< at `time`, if it came with a recorded frame
};

}  // namespace chainslam
