#pragma once

#include <optional>

#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/map/keyframe_scan.hpp"
#include "chainslam/sensor/gnss_fix.hpp"

namespace chainslam {

/// A frame that the map keeps. Scans are shared and never change; only `T_map_body` moves when the graph is optimized.
struct Keyframe {
  KeyframeId id{};                ///< position among the map's keyframes
  SessionId session{};            ///< the session that it belongs to
  Timestamp time{};               ///< of the pose
  SE3d T_odom_body{};             ///< as odometry gave it, in its session's own frame
  SE3d T_map_body{};              ///< the graph's latest estimate
  KeyframeScan cloud{};           ///< body frame, motion-corrected, voxelised
  std::optional<GnssFix> gnss{};  ///< interpolated to `time`
};

}  // namespace chainslam
