#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "chainslam/sensor/frame.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "drive.hpp"

namespace chainslam::lamm {

/// A keyframe set, read whole.
struct KeyframeSet {
  Drive drive;
  std::vector<Keyframe> keyframes;  ///< one for each scan of the drive; T_map_body is odometry's
  std::vector<FrameRecord> frames;  ///< one for each frame of the drive
  std::optional<Trajectory> truth;  ///< T_map_body, if the set has it
  std::string truth_frame;          ///< truths of sets with the same are in one frame; empty: its own
  std::string title;                ///< name, and how the data came about
  std::vector<std::string> notes;
};

/// Reads what `chainslam odometry` writes, or another keyframe set with odometry. Frames that odometry lost have no
/// scan, as in mapping.
/// @throws IoError if the folder is none, has no scan of use, or a file of it cannot be read.
[[nodiscard]] KeyframeSet read_keyframe_set(const std::filesystem::path& folder);

}  // namespace chainslam::lamm
