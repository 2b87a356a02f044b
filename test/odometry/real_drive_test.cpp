#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <optional>
#include <string>
#include <vector>

#include "chainslam/evaluation/ape.hpp"
#include "chainslam/io/kitti.hpp"
#include "chainslam/io/pcd.hpp"
#include "chainslam/io/tum.hpp"
#include "chainslam/odometry/lidar_inertial_odometry.hpp"
#include "chainslam/odometry/lidar_odometry.hpp"
#include "support/quick.hpp"
#include "support/real_data.hpp"

using namespace chainslam;

namespace {

/// One revolution in NCLT's `velodyne_sync` layout: x, y, z as uint16 of 5 mm from -100 m, intensity, laser.
LidarScan read_revolution(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  const std::vector<char> bytes((std::istreambuf_iterator<char>(file)), {});
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

/// LiDAR scans with their reference, and IMU measurements where there are any.
struct Drive {
  std::vector<LidarScan> scans;
  std::vector<ImuSample> imu;
  Trajectory reference;  ///< of the LiDAR, a pose for each scan
  SE3d T_body_lidar{};
};

/// IMU measurements in rows of `timestamp,gx,gy,gz,ax,ay,az`; those before `begin` (seconds) are left out.
std::vector<ImuSample> read_imu(const std::filesystem::path& path, double begin) {
  std::ifstream file(path);
  std::vector<ImuSample> samples;
  for (std::string line; std::getline(file, line);) {
    double t = 0;
    ImuSample sample;
    Eigen::Vector3d &w = sample.gyro, &a = sample.accel;
    if (std::sscanf(line.c_str(), "%lf,%lf,%lf,%lf,%lf,%lf,%lf", &t, &w[0], &w[1], &w[2], &a[0], &a[1], &a[2]) != 7)
      continue;
    sample.time = Timestamp::from_seconds(t);
    if (t >= begin) samples.push_back(sample);
  }
  return samples;
}

/// The first 101 scans of KITTI 00 (corrected for motion), with its IMU where that was recorded.
std::optional<Drive> read_kitti() {
  const auto folder = test::real_data("kitti00_first101/kitti00_first101");
  const auto imu = test::real_data("kitti00_first101/kitti00_first101_imu.csv");
  if (!folder || !imu) return std::nullopt;
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(*folder / "velodyne_sync"))
    files.push_back(entry.path());
  std::ranges::sort(files);
  Drive drive;
  for (const auto& file : files) drive.scans.push_back(read_revolution(file));
  constexpr double first_recorded = 1317600001.392;  // before, the source drew a straight line
  drive.imu = read_imu(*imu, first_recorded);
  drive.reference = read_tum(*folder / "poses_semantickitti.tum");
  Eigen::Matrix3d R_lidar_imu;  // KITTI's calib_imu_to_velo, 2011_09_26
  R_lidar_imu << 0.9999976, 7.553071e-04, -2.035826e-03, -7.854027e-04, 0.9998898, -1.482298e-02, 2.024406e-03,
      1.482454e-02, 0.9998881;
  drive.T_body_lidar = SE3d(SO3d::from_matrix(R_lidar_imu), {-0.8086759, 0.3195559, -0.7997231}).inverse();
  return drive;
}

/// 39 scans of nuScenes at 2 Hz: 32 rings, 91 m.
std::optional<Drive> read_nuscenes() {
  const auto folder = test::real_data("nuscenes_scene/nuscenes_scene");
  if (!folder) return std::nullopt;
  Drive drive;
  for (int i = 0; i < 39; ++i) {
    const auto time = Timestamp::from_seconds(0.5 * i);
    drive.scans.push_back(
        {.time = time, .end = time, .cloud = read_pcd(*folder / "clouds" / (std::to_string(i) + ".pcd"))});
    const Trajectory pose = read_kitti_poses(*folder / "poses" / (std::to_string(i) + ".txt"));
    drive.reference.poses.push_back(pose.poses.at(0));
  }
  return drive;
}

/// Feeds every n-th scan. @returns the APE of the LiDAR's position, metres (rms, aligned). No scan may be lost or
/// degenerate.
template <class Odometry>
double error_at(const Drive& drive, std::size_t n) {
  typename Odometry::Options options;
  options.T_body_lidar = drive.T_body_lidar;
  Odometry odometry(options);
  Trajectory found, reference;
  const auto take = [&](const std::optional<Frame>& frame) {
    if (frame) found.poses.push_back(frame->T_odom_body * drive.T_body_lidar);
  };
  auto sample = drive.imu.begin();
  for (std::size_t i = 0; i < drive.scans.size(); i += n) {
    for (; sample != drive.imu.end() && sample->time <= drive.scans[i].end; ++sample)
      take(odometry.process(Packet(*sample)));
    take(odometry.process(Packet(drive.scans[i])));
    reference.poses.push_back(drive.reference.poses[i]);
  }
  if constexpr (requires { odometry.flush(); })
    while (const auto frame = odometry.flush()) take(frame);
  CHECK(odometry.counts().lost_scans == 0);
  CHECK(odometry.counts().degenerate_scans == 0);
  REQUIRE(found.size() == reference.size());
  const AbsolutePoseErrors errors = ape(reference, found);
  REQUIRE(errors.status == EvaluationStatus::evaluated);
  return errors.translation.rmse;
}

}  // namespace

TEST_SUITE("odometry on a real drive") {
  // Steps of 0.7 to 4.7 m, the first at an unknown speed: a gate that shrinks before the pose has converged loses it.
  TEST_CASE("83 m of KITTI 00, every first to fifth scan, from the first scan on at speed" *
            doctest::skip(test::quick())) {
    std::optional<Drive> drive = read_kitti();
    if (!drive) return;
    Drive without_imu = *drive;
    without_imu.imu.clear();
    for (std::size_t n = 1; n <= 5; ++n) {
      const double lidar = error_at<LidarOdometry<>>(without_imu, n);
      const double inertial = error_at<LidarInertialOdometry<>>(*drive, n);
      MESSAGE("one scan of ", n, ": LiDAR alone ", lidar, " m, with IMU ", inertial, " m");
      CHECK(lidar < 0.12);
      CHECK(inertial < 0.12);
    }
  }

  TEST_CASE("nuScenes at 2 Hz: steps of up to five metres" * doctest::skip(test::quick())) {
    const std::optional<Drive> drive = read_nuscenes();
    if (!drive) return;
    const double lidar = error_at<LidarOdometry<>>(*drive, 1);
    MESSAGE("LiDAR alone ", lidar, " m");
    CHECK(lidar < 0.12);
  }
}
