#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <limits>
#include <numbers>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/io/pcd.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/sensor/packet.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "support/real_data.hpp"

namespace chainslam::test {

/// A span of time in seconds, its end left out.
struct TimeSpan {
  double begin = 0, end = 0;
  [[nodiscard]] bool contains(Timestamp time) const { return time.to_seconds() >= begin && time.to_seconds() < end; }
};

/// A recorded drive in memory: scans, IMU measurements where there are any, and the reference for the poses.
struct Drive {
  std::vector<LidarScan> scans;
  std::vector<ImuSample> imu;
  Trajectory reference;               ///< T_world_lidar; to be interpolated to the times of frames
  std::vector<TimeSpan> not_counted;  ///< spans in which the reference itself is interpolated
  SE3d T_body_lidar{};                ///< body = the IMU
};

/// Which rows of a KITTI drive's IMU file are read: in gaps of the recording its source drew straight lines.
enum class ImuRows { measured, with_filled_gaps };

/// Whether the points of raw sweeps get their times, or the sweeps are passed on as snapshots.
enum class PointTimes { from_azimuth, none };

namespace internal {

/// Rows of `timestamp,gx,gy,gz,ax,ay,az` (seconds, rad/s, m/s^2) outside of `gaps`.
inline std::vector<ImuSample> read_imu_rows(const std::filesystem::path& path, const std::vector<TimeSpan>& gaps) {
  std::ifstream file(path);
  std::vector<ImuSample> samples;
  for (std::string line; std::getline(file, line);) {
    double t = 0;
    ImuSample sample;
    Eigen::Vector3d &w = sample.gyro, &a = sample.accel;
    if (std::sscanf(line.c_str(), "%lf,%lf,%lf,%lf,%lf,%lf,%lf", &t, &w[0], &w[1], &w[2], &a[0], &a[1], &a[2]) != 7)
      continue;
    sample.time = Timestamp::from_seconds(t);
    if (std::ranges::none_of(gaps, [&](const TimeSpan& gap) { return gap.contains(sample.time); }))
      samples.push_back(sample);
  }
  return samples;
}

/// One revolution in NCLT's `velodyne_sync` layout: x, y, z as uint16 of 5 mm from -100 m, intensity, laser.
inline LidarScan read_revolution(const std::filesystem::path& path) {
  std::vector<char> bytes(std::filesystem::file_size(path));
  std::ifstream(path, std::ios::binary).read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  LidarScan scan;
  scan.time = scan.end = Timestamp::from_microseconds(std::stoll(path.stem().string()));
  for (std::size_t at = 0; at + 8 <= bytes.size(); at += 8) {
    std::uint16_t raw[3];
    std::memcpy(raw, bytes.data() + at, sizeof(raw));
    const auto metres = [](std::uint16_t value) { return static_cast<float>(value * 0.005 - 100); };
    scan.cloud.positions.emplace_back(metres(raw[0]), metres(raw[1]), metres(raw[2]));
  }
  return scan;
}

/// A sweep of KITTI's HDL-64E, which turns clockwise from the rear and looks forward at `middle`.
inline LidarScan turning_sweep(PointCloud<float> cloud, Timestamp middle) {
  constexpr double period = 0.1036;  // seconds a turn
  LidarScan scan{.time = middle - seconds(period / 2), .end = middle + seconds(period / 2), .cloud = std::move(cloud)};
  const double span = to_seconds(scan.end - scan.time);
  for (const Eigen::Vector3f& p : scan.cloud.positions) {
    const double turned = 0.5 - std::atan2(p.y(), p.x()) / (2 * std::numbers::pi);
    scan.cloud.time_offsets.push_back(static_cast<float>(std::clamp(turned, 0.0, 1.0) * span));
  }
  return scan;
}

/// The mounting of KITTI's IMU, p_lidar = R p_imu + t: calib_imu_to_velo of 2011_09_26, which 2011_10_03's is near.
inline SE3d kitti_T_body_lidar() {
  Eigen::Matrix3d R_lidar_imu;
  R_lidar_imu << 0.9999976, 7.553071e-04, -2.035826e-03, -7.854027e-04, 0.9998898, -1.482298e-02, 2.024406e-03,
      1.482454e-02, 0.9998881;
  return SE3d(SO3d::from_matrix(R_lidar_imu), {-0.8086759, 0.3195559, -0.7997231}).inverse();
}

/// KITTI 00's ground truth at all frames, turned into the LiDAR's frame. @param delay  seconds added to KITTI's times.
inline std::optional<Trajectory> kitti00_truth(double delay) {
  const auto poses = real_data("trajectories/evo/KITTI_00_gt.txt");
  const auto times = real_data("trajectories/evo/KITTI_00_gt_times.txt");
  if (!poses || !times) return std::nullopt;
  Trajectory truth = read_kitti_poses(*poses);
  std::ifstream file(*times);
  for (double time = 0; file >> time;) truth.times.push_back(Timestamp::from_seconds(time + delay));
  Eigen::Matrix3d R_camera_lidar;  // Tr of the odometry benchmark's sequence 00
  R_camera_lidar << 4.276802385584e-04, -9.999672484946e-01, -8.084491683471e-03, -7.210626507497e-03,
      8.081198471645e-03, -9.999413164504e-01, 9.999738645903e-01, 4.859485810390e-04, -7.206933692422e-03;
  const SE3d T_camera_lidar(SO3d::from_matrix(R_camera_lidar),
                            {-1.198459927713e-02, -5.403984729748e-02, -2.921968648686e-01});
  for (SE3d& pose : truth.poses) pose = T_camera_lidar.inverse() * pose * T_camera_lidar;
  return truth;
}

}  // namespace internal

/// The first 101 scans of KITTI 00 (10 Hz, corrected for motion, at 8 m/s from the first one on) with its IMU. Nothing
/// if the data are not at hand. Reference: SemanticKITTI's poses.
inline std::optional<Drive> kitti00_first101(ImuRows rows = ImuRows::measured) {
  const auto folder = real_data("kitti00_first101/kitti00_first101");
  const auto imu = real_data("kitti00_first101/kitti00_first101_imu.csv");
  if (!folder || !imu) return std::nullopt;
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(*folder / "velodyne_sync"))
    files.push_back(entry.path());
  std::ranges::sort(files);
  Drive drive;
  for (const auto& file : files) drive.scans.push_back(internal::read_revolution(file));
  std::vector<TimeSpan> gaps;
  if (rows == ImuRows::measured) gaps.push_back({-std::numeric_limits<double>::infinity(), 1317600001.392});
  drive.imu = internal::read_imu_rows(*imu, gaps);
  drive.reference = read_tum(*folder / "poses_semantickitti.tum");
  drive.T_body_lidar = internal::kitti_T_body_lidar();
  return drive;
}

/// 228 raw sweeps of KITTI 00, about 2 m apart, 398 m, with its IMU. Nothing if the data are not at hand. Reference:
/// KITTI's ground truth at 10 Hz, except for keyframes 140 to 145, where it is interpolated as the IMU is.
inline std::optional<Drive> kitti00_keyframes(PointTimes times = PointTimes::from_azimuth,
                                              ImuRows rows = ImuRows::measured) {
  const auto folder = real_data("kitti00_keyframes_imu/kitti00_keyframes_imu/kitti00_keyframes_imu");
  auto truth = internal::kitti00_truth(100);  // the folder's clock is KITTI's + 100 s
  if (!folder || !truth) return std::nullopt;
  Drive drive;
  std::ifstream stamps(*folder / "scans/times.txt");
  for (double stamp = 0; stamps >> stamp;) {
    char name[16];
    std::snprintf(name, sizeof name, "%06zu.pcd", drive.scans.size());
    const auto time = Timestamp::from_seconds(stamp);
    PointCloud<float> cloud = read_pcd(*folder / "scans" / name);
    drive.scans.push_back(times == PointTimes::from_azimuth
                              ? internal::turning_sweep(std::move(cloud), time)
                              : LidarScan{.time = time, .end = time, .cloud = std::move(cloud)});
  }
  std::vector<TimeSpan> gaps;
  std::ifstream filled(*folder / "imu_filled.txt");
  for (TimeSpan gap; rows == ImuRows::measured && filled >> gap.begin >> gap.end;) gaps.push_back(gap);
  drive.imu = internal::read_imu_rows(*folder / "imu.csv", gaps);
  drive.reference = std::move(*truth);
  drive.not_counted = {{135.87, 137.40}};  // frames 346 to 361
  drive.T_body_lidar = internal::kitti_T_body_lidar();
  return drive;
}

/// 39 scans of nuScenes at 2 Hz: 32 rings, 91 m, no IMU. Nothing if the data are not at hand.
inline std::optional<Drive> nuscenes_scene() {
  const auto folder = real_data("nuscenes_scene/nuscenes_scene");
  if (!folder) return std::nullopt;
  Drive drive;
  for (int i = 0; i < 39; ++i) {
    const auto time = Timestamp::from_seconds(0.5 * i);
    drive.scans.push_back(
        {.time = time, .end = time, .cloud = read_pcd(*folder / "clouds" / (std::to_string(i) + ".pcd"))});
    const Trajectory pose = read_kitti_poses(*folder / "poses" / (std::to_string(i) + ".txt"));
    drive.reference.times.push_back(time);
    drive.reference.poses.push_back(pose.poses.at(0));
  }
  return drive;
}

/// The drive with every n-th scan only, from the first one on, and all else as it is.
inline Drive every_nth_scan(Drive drive, std::size_t n) {
  std::vector<LidarScan> kept;
  for (std::size_t i = 0; i < drive.scans.size(); i += n) kept.push_back(std::move(drive.scans[i]));
  drive.scans = std::move(kept);
  return drive;
}

}  // namespace chainslam::test
