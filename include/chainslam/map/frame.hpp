#pragma once

#include <optional>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/sensor/gnss_fix.hpp"

namespace chainslam {

/// How well odometry held on to one scan.
enum class FrameStatus { good, degenerate, lost };

struct FrameHealth {
  FrameStatus status = FrameStatus::good;
  Index points = 0;         ///< given to registration
  Index matches = 0;        ///< that found a partner
  double residual_rms = 0;  ///< metres, over matches
  Index iterations = 0;
};

/// What odometry says of one scan.
struct Frame {
  Timestamp time;  ///< the pose holds at this time
  SE3d T_odom_body;
  Matrix6d covariance = Matrix6d::Identity();  ///< of T_odom_body, tangent [translation; rotation]
  PointCloud<float> cloud;                     ///< motion-corrected to `time`, body frame
  FrameHealth health;
  std::optional<GnssFix> gnss{};  ///< at `time`, if it came with a recorded frame
};

}  // namespace chainslam
