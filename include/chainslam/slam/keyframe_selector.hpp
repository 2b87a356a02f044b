#pragma once

#include <memory>
#include <optional>

#include "chainslam/cloud/quantize.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/sensor/frame.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam {

/// Which frames become keyframes. The paper: 3 m (NCLT) or 10 m (MARS), or 0.2 rad.
struct KeyframeOptions {
  double distance = 3.0;    ///< metres from the last keyframe; 0 takes every frame
  double angle = 0.2;       ///< radians turned since the last keyframe
  double scan_voxel = 0.4;  ///< metres, of the scan that is kept: the voxel at which closures are sought; 0 keeps all
  /// Metres to which its points are rounded, as map files do: a map that is loaded then has the scans that it had. 0
  /// keeps them as they are.
  double scan_step = 0.01;

  friend bool operator==(const KeyframeOptions&, const KeyframeOptions&) = default;  ///< whether all members are equal
};

/// Picks frames that have moved far enough from the last one picked. Frames that odometry lost are never picked: their
/// scans would go to the map at a guessed place. Neither are frames without a scan, of which a recording has only the
/// pose.
class KeyframeSelector {
 public:
  /// Starts without a keyframe: the next frame is one.
  explicit KeyframeSelector(const KeyframeOptions& options = {}) : options_(options) {}

  /// @returns the frame as a keyframe without id and session, which the back end gives; nothing if it is too near.
  [[nodiscard]] std::optional<Keyframe> operator()(const Frame& frame) {
    if (frame.health.status == FrameStatus::lost || frame.cloud.empty()) return std::nullopt;
    if (!moved_enough(frame.T_odom_body)) return std::nullopt;
    last_ = frame.T_odom_body;
    Keyframe keyframe;
    keyframe.time = frame.time;
    keyframe.T_odom_body = frame.T_odom_body;
    keyframe.gnss = frame.gnss;
    keyframe.cloud = std::make_shared<const PointCloud<float>>(kept_scan(frame.cloud));
    return keyframe;
  }

 private:
  [[nodiscard]] PointCloud<float> kept_scan(const PointCloud<float>& scan) const {
    PointCloud<float> kept = options_.scan_voxel > 0 ? voxel_downsample(scan, options_.scan_voxel) : scan;
    return options_.scan_step > 0 ? quantized(kept, options_.scan_step) : kept;
  }

  [[nodiscard]] bool moved_enough(const SE3d& T_odom_body) const {
    if (!last_ || options_.distance <= 0) return true;
    const SE3d motion = last_->inverse() * T_odom_body;
    return motion.translation().norm() >= options_.distance || motion.rotation().log().norm() >= options_.angle;
  }

  KeyframeOptions options_;
  std::optional<SE3d> last_;
};

}  // namespace chainslam
