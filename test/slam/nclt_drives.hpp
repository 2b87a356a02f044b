#pragma once

#include <cstddef>
#include <filesystem>
#include <stdexcept>
#include <vector>

#include "chainslam/core/timestamp.hpp"
#include "chainslam/io/input_file.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/lie/umeyama.hpp"
#include "chainslam/trajectory/trajectory.hpp"

// Three real drives of NCLT over one campus, months apart: another system's odometry, which says nothing of its errors,
// and truth in one frame.

namespace chainslam::test {

/// One drive at the keyframes' places.
struct RealDrive {
  std::vector<Timestamp> times;
  std::vector<SE3d> odometry;
  std::vector<SE3d> truth;  ///< all drives in one frame, of the odometry's body
};

inline std::vector<SE3d> read_nclt_truth(const std::filesystem::path& path) {
  std::vector<SE3d> poses;
  InputFile file(path);
  while (const auto line = file.read_line()) {
    if (line->starts_with('#')) continue;
    LineFields fields(file, *line, ',');
    fields.text("utime");
    Vector6d v;
    for (double& value : v) value = fields.number("pose");
    const SO3d rotation = SO3d::exp({0, 0, v[5]}) * SO3d::exp({0, v[4], 0}) * SO3d::exp({v[3], 0, 0});
    poses.push_back(SE3d(rotation, v.head<3>()));
  }
  return poses;
}

/// The rotation between the bodies of odometry and truth, from what both say of the way covered in ten seconds.
inline SO3d nclt_mounting(const std::vector<SE3d>& odometry, const std::vector<SE3d>& truth) {
  constexpr std::size_t steps = 25;
  std::vector<Eigen::Vector3d> from, to;
  for (std::size_t i = 0; i + steps < odometry.size(); i += 7) {
    from.push_back((odometry[i].inverse() * odometry[i + steps]).translation());
    to.push_back((truth[i].inverse() * truth[i + steps]).translation());
  }
  return umeyama(from, to, false).value().rotation();
}

inline RealDrive read_nclt_drive(const std::filesystem::path& folder, double keyframe_distance) {
  const Trajectory odometry = read_tum(folder / "odometry.tum");
  std::vector<SE3d> truth = read_nclt_truth(folder / "groundtruth.csv");
  if (truth.size() != odometry.size()) throw std::runtime_error("NCLT: truth and odometry have not as many rows");
  const SE3d T_body_odom_body(nclt_mounting(odometry.poses, truth), Eigen::Vector3d::Zero());
  RealDrive drive;
  for (std::size_t i = 0; i < truth.size(); ++i) {
    const SE3d& pose = odometry.poses[i];
    if (i > 0 && (drive.odometry.back().inverse() * pose).translation().norm() < keyframe_distance) continue;
    drive.times.push_back(odometry.times[i]);
    drive.odometry.push_back(pose);
    drive.truth.push_back(truth[i] * T_body_odom_body);
  }
  return drive;
}

/// @param keyframe_distance  metres
inline std::vector<RealDrive> read_nclt_drives(const std::filesystem::path& folder, double keyframe_distance) {
  std::vector<RealDrive> drives;
  for (const char* day : {"2012-01-08", "2012-04-29", "2012-08-04"})
    drives.push_back(read_nclt_drive(folder / day, keyframe_distance));
  return drives;
}

}  // namespace chainslam::test
