#pragma once

#include "chainslam/io/atomic_file.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::mapper {

/// Writes a CSV table of all frames of a map: session, time, T_odom_body, status and what it rests on, and the upper
/// triangle of the pose's covariance, tangent [translation; rotation], metres and radians. @throws IoError
void write_frames(const FileTarget& target, const SlamMap& map);

}  // namespace chainslam::mapper
