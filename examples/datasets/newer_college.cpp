#include "datasets/newer_college.hpp"

#include <string>
#include <utility>

#include "chainslam/io/pcd.hpp"
#include "datasets/extrinsic.hpp"
#include "datasets/files.hpp"
#include "datasets/imu_table.hpp"
#include "datasets/ouster.hpp"
#include "datasets/pose_table.hpp"
#include "datasets/scan_files.hpp"

// Newer College (Ramezani et al. 2020): raw_format/ouster_scan/cloud_<sec>_<nsec>.pcd, column by column of an OS1-64 at
// 10 Hz; ground_truth/registered_poses.csv (sec, nsec, x y z qx qy qz qw of the camera); the inertial unit's table, if
// it was exported beside the scans (see `find_imu_table`).

namespace chainslam::datasets {
namespace {

namespace fs = std::filesystem;

/// As the release states it.
SE3d T_camera_lidar() {
  return SE3d(SO3d::from_quaternion(Eigen::Quaterniond(0.383, 0, 0, 0.924).normalized()), {-0.084, -0.025, 0.050});
}

/// Of the OS1's own inertial unit, by its maker.
SE3d T_imu_lidar() {
  return SE3d(SO3d::from_quaternion(Eigen::Quaterniond(0, 0, 0, 1)), {0.006253, -0.011775, 0.007645});
}

Timestamp seconds_and_nanoseconds(LineFields& fields) {
  const Timestamp whole = fields.time_in_seconds("sec");
  const std::int64_t nanoseconds = fields.integer("nsec");
  if (nanoseconds < 0 || nanoseconds >= 1'000'000'000)
    fields.fail("nsec", std::to_string(nanoseconds), "write what is beyond the whole second, below 1e9");
  return whole + Duration(nanoseconds);
}

}  // namespace

fs::path newer_college_scans(const fs::path& path) {
  for (const char* name : {"raw_format/ouster_scan", "ouster_scan"}) {
    const auto files = files_in(path / name, {".pcd"});
    if (!files.empty() && time_of_name(files.front().stem().string())) return path / name;
  }
  return {};
}

std::unique_ptr<Dataset> open_newer_college(const fs::path& path, const DatasetOptions& options) {
  const fs::path folder = newer_college_scans(path);
  const std::vector<fs::path> files = files_in(folder, {".pcd"});
  const std::vector<Timestamp> times = times_of_names(files);
  ScanFiles parts = scans_of(DatasetKind::newer_college, path,
                             {"ouster_scan", SensorKind::lidar, files.size(), "times of points by column, 1024 a turn"},
                             times.front(), times.back());
  DatasetInfo& info = parts.info;
  parts.read = [=](std::size_t i) { return ouster_scan(times[i], read_pcd(files[i])); };
  for (const fs::path& place : {folder.parent_path(), path}) {
    const fs::path table = find_imu_table(place);
    if (table.empty() || !parts.others.empty()) continue;
    add_imu_table(parts, options, table, imu_columns(table));
  }
  const bool inertial = !parts.others.empty();
  auto stated = find_extrinsic({path, folder.parent_path()});
  if (inertial && !stated) stated = {T_imu_lidar(), "the maker's data of the OS1's own IMU"};
  set_extrinsic(options, stated, inertial, info);
  fs::path poses;
  for (const fs::path& place : {path / "ground_truth", path})
    if (poses.empty() && fs::is_regular_file(place / "registered_poses.csv")) poses = place / "registered_poses.csv";
  info.truth_frame = "Newer College";
  set_truth(parts, options, poses, [poses, T_camera_body = T_camera_lidar() * info.T_body_lidar.inverse()] {
    Trajectory truth = read_pose_table(poses, ',', seconds_and_nanoseconds, read_position_and_quaternion);
    for (SE3d& pose : truth.poses) pose = pose * T_camera_body;
    return truth;
  });
  return dataset_of(std::move(parts));
}

}  // namespace chainslam::datasets
