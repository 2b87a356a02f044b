#pragma once

#include <span>
#include <string>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/sensor/frame.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam::support {

/// Why frames are listed, the gravest first.
enum class FrameConcern {
  lost,           ///< no match in the local map, or the local map restarted
  gap,            ///< no frame for longer than the motion can be predicted
  degenerate,     ///< directions that the scans do not observe
  accelerometer,  ///< contradicted by the scans for a while: single scans do so at any pothole
  gyroscope,      ///< contradicted by the scans for a while
  imu             ///< not used, or without measurements, for a while
};

/// A concern in words: "scans lost".
[[nodiscard]] std::string name_of(FrameConcern concern);

/// Frames of one concern, with pauses of less than a second between them.
struct FrameInterval {
  FrameConcern concern = FrameConcern::lost;
  double begin = 0, end = 0;  ///< seconds since the session's first frame
  Index frames = 0;           ///< of the concern
  Index restarts = 0;         ///< of the local map, among them
  double distance = 0;        ///< metres, by odometry, from the last frame before it to its end
  Index first = 0, last = 0;  ///< numbers of these frames in the session
};

/// Frames by what of the IMU their poses rely on; those of odometry without one are not counted.
struct ImuUseCounts {
  Index all = 0;
  Index gyroscope = 0;
  Index scans_only = 0;  ///< or a gyroscope that only undistorts

  [[nodiscard]] Index frames() const { return all + gyroscope + scans_only; }
  /// Of all that are counted; 0 to 1.
  [[nodiscard]] double share(Index count) const {
    return frames() > 0 ? static_cast<double>(count) / static_cast<double>(frames()) : 0;
  }
};

/// "98.0 % of frames with all of the IMU, 1.5 % with its gyroscope, 0.5 % by scans alone"; empty without frames.
[[nodiscard]] std::string text_of(const ImuUseCounts& counts);

/// How well odometry followed one session.
struct SessionHealth {
  Index frames = 0;
  Index lost = 0;
  Index degenerate = 0;
  Index restarts = 0;
  ImuUseCounts imu_use{};
  std::vector<FrameInterval> intervals{};  ///< in the order of their begin
};

/// @param frames  of one session, in the order of time.
[[nodiscard]] SessionHealth health_of(std::span<const FrameRecord> frames);

/// Times and poses of frames.
[[nodiscard]] Trajectory odometry_of(std::span<const FrameRecord> frames);

}  // namespace chainslam::support
