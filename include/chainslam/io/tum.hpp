#pragma once

#include <filesystem>
#include <stdexcept>
#include <string>

#include "chainslam/io/atomic_file.hpp"
#include "chainslam/io/detail/pose_fields.hpp"
#include "chainslam/io/input_file.hpp"
#include "chainslam/io/line_fields.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam {

/// Reads a trajectory in TUM's format: lines `t x y z qx qy qz qw`, seconds and metres; '#' starts a comment line.
///
/// Seconds become nanoseconds digit by digit, without loss. Stamps may repeat but not go back. A file without poses
/// gives an empty trajectory. Format: Sturm et al. 2012, the TUM RGB-D benchmark.
/// @throws IoError naming line and field: not a number, missing or extra fields, a stamp before the last one, a
///   quaternion whose length is not 1 within 1e-3.
[[nodiscard]] inline Trajectory read_tum(const std::filesystem::path& path) {
  InputFile file(path);
  Trajectory trajectory;
  while (const auto line = file.read_line()) {
    const std::string_view text = detail::trimmed(*line);
    if (text.empty() || text.starts_with('#')) continue;
    LineFields fields(file, text);
    const Timestamp time = fields.time_in_seconds("t");
    if (!trajectory.times.empty() && time < trajectory.times.back())
      fields.fail("t", "a stamp that is earlier than the one before it", "sort the lines by time");
    const Eigen::Vector3d position = detail::read_position(fields);
    const SO3d rotation = detail::read_quaternion(fields, detail::QuaternionOrder::xyzw);
    fields.end("eight fields: t x y z qx qy qz qw");
    trajectory.times.push_back(time);
    trajectory.poses.push_back(SE3d(rotation, position));
  }
  return trajectory;
}

/// Writes a trajectory in TUM's format: stamps with nine decimals, exact; the rest as short as reads back the same.
/// @throws std::invalid_argument if poses have no times; IoError if a pose is not finite or it cannot be written, the
/// old file then stays.
inline void write_tum(const FileTarget& target, const Trajectory& trajectory) {
  if (trajectory.times.size() != trajectory.poses.size())
    throw std::invalid_argument("write_tum: the trajectory needs one time for each pose");
  AtomicFile file(target);
  std::string line;
  for (std::size_t i = 0; i < trajectory.size(); ++i) {
    detail::require_finite(target, "pose", i, trajectory.poses[i]);
    line.clear();
    detail::append_seconds(line, trajectory.times[i]);
    detail::append_position(line, trajectory.poses[i].translation());
    detail::append_quaternion(line, trajectory.poses[i].rotation());
    file.write(line += '\n');
  }
  file.commit();
}

}  // namespace chainslam
