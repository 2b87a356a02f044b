#pragma once

#include <cstddef>
#include <filesystem>
#include <string>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/io/atomic_file.hpp"
#include "chainslam/io/bytes.hpp"
#include "chainslam/io/detail/point_records.hpp"
#include "chainslam/io/detail/pose_fields.hpp"
#include "chainslam/io/input_file.hpp"
#include "chainslam/io/line_fields.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam {

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
