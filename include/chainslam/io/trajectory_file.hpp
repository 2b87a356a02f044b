#pragma once

#include <cstddef>
#include <filesystem>
#include <stdexcept>
#include <string>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/byte_archive.hpp"
#include "chainslam/io/atomic_file.hpp"
#include "chainslam/io/detail/point_records.hpp"
#include "chainslam/io/detail/pose_fields.hpp"
#include "chainslam/io/input_file.hpp"
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
  trajectory.times.shrink_to_fit();  // programs keep those of all sessions
  trajectory.poses.shrink_to_fit();
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

/// Reads one of KITTI's Velodyne scans: records of four little-endian floats, x y z (metres, x forward, y left, z up)
/// and reflectance. Points are kept as they are, NaN among them.
/// Format: Geiger et al. 2013, Vision meets Robotics: the KITTI data set.
/// @throws IoError if the file's size is no multiple of 16 bytes or it cannot be read.
[[nodiscard]] inline PointCloud<float> read_kitti_bin(const std::filesystem::path& path) {
  return detail::read_point_records(path, 16, "KITTI's scans hold 16 bytes a point (x y z reflectance)",
                                    [](const std::byte* record, PointCloud<float>& cloud) {
                                      cloud.positions.emplace_back(load_as<float>(record), load_as<float>(record + 4),
                                                                   load_as<float>(record + 8));
                                      cloud.intensities.push_back(load_as<float>(record + 12));
                                    });
}

/// Reads KITTI's poses: rows of 12 numbers, the row-major 3x4 matrix [R | t]. The trajectory has no times.
///
/// Rotations may be off by 1e-3, as files with few digits are, and are made exact. '#' starts a comment line.
/// @throws IoError naming line and field: not a number, not 12 numbers, no rotation.
[[nodiscard]] inline Trajectory read_kitti_poses(const std::filesystem::path& path) {
  InputFile file(path);
  Trajectory trajectory;
  while (const auto line = file.read_line()) {
    const std::string_view text = detail::trimmed(*line);
    if (text.empty() || text.starts_with('#')) continue;
    LineFields fields(file, text);
    trajectory.poses.push_back(detail::read_matrix_3x4(fields));
    fields.end("twelve numbers, a row-major 3x4 matrix");
  }
  return trajectory;
}

/// Writes poses as KITTI does; times are not written.
/// @throws IoError if a pose is not finite or it cannot be written; the old file then stays.
inline void write_kitti_poses(const FileTarget& target, const Trajectory& trajectory) {
  AtomicFile file(target);
  std::string line;
  for (std::size_t pose = 0; pose < trajectory.size(); ++pose) {
    detail::require_finite(target, "pose", pose, trajectory.poses[pose]);
    const Eigen::Matrix4d matrix = trajectory.poses[pose].matrix();
    line.clear();
    for (int i = 0; i < 12; ++i) {
      detail::append_number(line, matrix(i / 4, i % 4));
      line += i < 11 ? ' ' : '\n';
    }
    file.write(line);
  }
  file.commit();
}

}  // namespace chainslam
