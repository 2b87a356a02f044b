#pragma once

#include <filesystem>

#include "chainslam/core/timestamp.hpp"
#include "chainslam/io/detail/pose_fields.hpp"
#include "chainslam/io/input_file.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam::datasets {

/// Reads a trajectory from a table with a line for each pose; lines that are empty or start with '#' are passed over.
///
/// @param time, pose  read the time and the pose from the line's fields, one after the other.
/// @throws IoError naming line and field, also of a time that is earlier than the one before it.
template <class Time, class Pose>
[[nodiscard]] Trajectory read_pose_table(const std::filesystem::path& path, char separator, const Time& time,
                                         const Pose& pose) {
  InputFile file(path);
  Trajectory trajectory;
  while (const auto line = file.read_line()) {
    const std::string_view text = detail::trimmed(*line);
    if (text.empty() || text.starts_with('#')) continue;
    LineFields fields(file, text, separator);
    const Timestamp at = time(fields);
    if (!trajectory.times.empty() && at < trajectory.times.back())
      fields.fail("time", "a time that is earlier than the one before it", "sort the lines by time");
    trajectory.poses.push_back(pose(fields));
    trajectory.times.push_back(at);
  }
  return trajectory;
}

/// A pose as `x y z qx qy qz qw`.
[[nodiscard]] inline SE3d read_position_and_quaternion(LineFields& fields) {
  const Eigen::Vector3d position = detail::read_position(fields);
  return SE3d(detail::read_quaternion(fields, detail::QuaternionOrder::xyzw), position);
}

}  // namespace chainslam::datasets
