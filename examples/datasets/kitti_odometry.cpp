#include <cmath>
#include <numbers>
#include <string>
#include <utility>

#include "chainslam/core/error.hpp"
#include "chainslam/io/input_file.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "datasets/extrinsic.hpp"
#include "datasets/files.hpp"
#include "datasets/imu_table.hpp"
#include "datasets/kitti_calibration.hpp"
#include "datasets/scan_files.hpp"
#include "datasets/statistics.hpp"

// A sequence of KITTI's odometry benchmark (Geiger, Lenz and Urtasun 2012): velodyne/NNNNNN.bin, already corrected for
// motion, times.txt, calib.txt with Tr = T_camera_lidar, and poses of the left camera in ../../poses/NN.txt or
// poses.txt. The benchmark has no IMU data; a table of one beside the scans (see `find_imu_table`) is read, with where
// the LiDAR sits on it (see `find_extrinsic`).

namespace chainslam::datasets {
namespace {

namespace fs = std::filesystem;

/// Turns every point upwards about the sensor: KITTI's own calibration of the HDL-64E has its lasers too low (Deschaud
/// 2018, IMLS-SLAM, section IV; 0.205 degrees as Dellenbach et al. 2022 found).
void raise(PointCloud<float>& cloud, double angle) {
  const auto sine = static_cast<float>(std::sin(angle)), cosine = static_cast<float>(std::cos(angle));
  for (Eigen::Vector3f& p : cloud.positions) {
    const float flat = p.head<2>().norm();
    if (!(flat > 0)) continue;
    const float up = cosine * p.z() + sine * flat;
    p.head<2>() *= (cosine * flat - sine * p.z()) / flat;
    p.z() = up;
  }
}

fs::path poses_of(const fs::path& path) {
  if (fs::is_regular_file(path / "poses.txt")) return path / "poses.txt";
  const fs::path whole = fs::absolute(path / "").lexically_normal().parent_path();
  const fs::path beside = whole.parent_path().parent_path() / "poses" / (whole.filename().string() + ".txt");
  return fs::is_regular_file(beside) ? beside : fs::path();
}

}  // namespace

std::unique_ptr<Dataset> open_kitti(const fs::path& path, const DatasetOptions& options) {
  const std::vector<fs::path> files = files_in(path / "velodyne", {".bin"});
  const std::vector<Timestamp> times = read_stamps(path / "times.txt");
  if (files.empty() || times.size() < files.size())
    throw_input_error(
        path.string(), "",
        std::to_string(files.size()) + " scans in velodyne, " + std::to_string(times.size()) + " lines in times.txt",
        "give one line of times.txt for each scan");
  ScanFiles parts =
      scans_of(DatasetKind::kitti, path, {"velodyne", SensorKind::lidar, files.size(), "corrected for motion by KITTI"},
               times.front(), times[files.size() - 1]);
  DatasetInfo& info = parts.info;
  if (const fs::path table = find_imu_table(path); !table.empty())
    add_imu_table(parts, options, table, imu_columns(table));
  set_extrinsic(options, find_extrinsic({path}), !parts.others.empty(), info);
  info.motion_corrected = true;
  if (times.size() > files.size())
    info.warnings.push_back(std::to_string(times.size() - files.size()) + " times have no scan");
  const double angle = options.kitti_elevation_offset_deg;
  if (angle != 0) info.notes.push_back("points turned " + text_of(angle) + " deg upwards, as KITTI's lasers ask for");
  parts.read = [=](std::size_t i) {
    LidarScan scan{.time = times[i], .end = times[i], .cloud = read_kitti_bin(files[i])};
    if (angle != 0) raise(scan.cloud, angle * std::numbers::pi / 180);
    return scan;
  };
  if (const fs::path poses = poses_of(path); !poses.empty()) {
    const SE3d T_camera_lidar = KittiCalibration(path / "calib.txt").matrix("Tr");
    set_truth(parts, options, poses, [=, T_camera_body = T_camera_lidar * info.T_body_lidar.inverse()] {
      Trajectory truth = read_kitti_poses(poses);
      if (truth.size() > times.size())
        throw_input_error(poses.string(), "",
                          std::to_string(truth.size()) + " poses for " + std::to_string(times.size()) + " times",
                          "give the poses of this sequence");
      for (SE3d& pose : truth.poses) pose = T_camera_lidar.inverse() * pose * T_camera_body;
      truth.times.assign(times.begin(), times.begin() + static_cast<std::ptrdiff_t>(truth.size()));
      return truth;
    });
  } else {
    info.truth = options.truth;
  }
  return dataset_of(std::move(parts));
}

}  // namespace chainslam::datasets
