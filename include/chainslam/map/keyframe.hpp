#pragma once

#include <optional>

#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/map/keyframe_scan.hpp"
#include "chainslam/sensor/gnss_fix.hpp"

namespace chainslam {

/// When a keyframe got its fix, so that a back end can be given the same again.
struct GnssArrival {
  KeyframeId after{};          ///< the newest keyframe then; none: it came with its own, or nothing is known
  bool with_previous = false;  ///< together with that of the keyframe before
  friend bool operator==(const GnssArrival&, const GnssArrival&) = default;  ///< whether all members are equal
};

/// A frame that the map keeps. Scans are shared and never change; only `T_map_body` moves when the graph is optimized.
struct Keyframe {
  KeyframeId id{};                ///< position among the map's keyframes
  SessionId session{};            ///< the session that it belongs to
  Timestamp time{};               ///< of the pose
  SE3d T_odom_body{};             ///< as odometry gave it, in its session's own frame
  SE3d T_map_body{};              ///< the graph's latest estimate
  KeyframeScan cloud{};           ///< body frame, motion-corrected, voxelised
  std::optional<GnssFix> gnss{};  ///< interpolated to `time`
  GnssArrival gnss_arrival{};     ///< of `gnss`
};

/// A keyframe's fix, which came after it.
struct KeyframeFix {
  KeyframeId keyframe{};  ///< where it was taken
  GnssFix fix{};          ///< interpolated to the keyframe's time
};

}  // namespace chainslam
