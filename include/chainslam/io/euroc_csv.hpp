#pragma once

#include <filesystem>

#include "chainslam/io/detail/pose_fields.hpp"
#include "chainslam/io/input_file.hpp"
#include "chainslam/io/line_fields.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam {

/// Reads EuRoC's ground truth, as evo does: lines `ns, x, y, z, qw, qx, qy, qz, ...`; fields after these are not read;
/// lines that start with '#' are headers.
///
/// Stamps may repeat but not go back. Format: Burri et al. 2016, the EuRoC micro aerial vehicle data sets.
/// @throws IoError naming line and field, as `read_tum`.
[[nodiscard]] inline Trajectory read_euroc_csv(const std::filesystem::path& path) {
  InputFile file(path);
  Trajectory trajectory;
  while (const auto line = file.read_line()) {
    const std::string_view text = detail::trimmed(*line);
    if (text.empty() || text.starts_with('#')) continue;
    LineFields fields(file, text, ',');
    const Timestamp time = Timestamp::from_nanoseconds(fields.integer("timestamp"));
    if (!is_recorded_time(time))
      fields.fail("timestamp", "a time beyond the year 2115", "write nanoseconds since 1970");
    if (!trajectory.times.empty() && time < trajectory.times.back())
      fields.fail("timestamp", "a stamp that is earlier than the one before it", "sort the lines by time");
    const Eigen::Vector3d position = detail::read_position(fields);
    const SO3d rotation = detail::read_quaternion(fields, detail::QuaternionOrder::wxyz);
    trajectory.times.push_back(time);
    trajectory.poses.push_back(SE3d(rotation, position));
  }
  return trajectory;
}

}  // namespace chainslam
