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

#include "chainslam/io/tum.hpp"
#include "chainslam/lie/umeyama.hpp"
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

/// Readings in rows of `timestamp,gx,gy,gz,ax,ay,az`; those before `begin` (seconds) are left out.
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

/// The first 101 scans of KITTI 00 with what was measured by its inertial unit.
struct Kitti {
  std::vector<LidarScan> scans;
  std::vector<ImuSample> imu;
  std::vector<SE3d> T_world_lidar;
  SE3d T_body_lidar;
};

std::optional<Kitti> read_kitti() {
  const auto folder = test::real_data("kitti00_first101/kitti00_first101");
  const auto imu = test::real_data("kitti00_first101/kitti00_first101_imu.csv");
  if (!folder || !imu) return std::nullopt;
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(*folder / "velodyne_sync"))
    files.push_back(entry.path());
  std::ranges::sort(files);
  Kitti kitti;
  for (const auto& file : files) kitti.scans.push_back(read_revolution(file));
  constexpr double first_measured = 1317600001.392;  // before, the source drew a straight line
  kitti.imu = read_imu(*imu, first_measured);
  kitti.T_world_lidar = read_tum(*folder / "poses_semantickitti.tum").poses;
  Eigen::Matrix3d R_lidar_imu;  // KITTI's calib_imu_to_velo, 2011_09_26
  R_lidar_imu << 0.9999976, 7.553071e-04, -2.035826e-03, -7.854027e-04, 0.9998898, -1.482298e-02, 2.024406e-03,
      1.482454e-02, 0.9998881;
  kitti.T_body_lidar = SE3d(SO3d::from_matrix(R_lidar_imu), {-0.8086759, 0.3195559, -0.7997231}).inverse();
  return kitti;
}

/// Feeds every n-th scan. @returns the position error of the LiDAR, metres (rms, aligned); infinite if a scan was lost.
template <class Odometry>
double error_at(const Kitti& kitti, std::size_t n, bool with_imu) {
  typename Odometry::Options options;
  options.T_body_lidar = kitti.T_body_lidar;
  Odometry odometry(options);
  std::vector<Eigen::Vector3d> found, reference;
  const auto take = [&](const std::optional<Frame>& frame) {
    if (frame) found.push_back((frame->T_odom_body * kitti.T_body_lidar).translation());
  };
  auto reading = kitti.imu.begin();
  for (std::size_t i = 0; i < kitti.scans.size(); i += n) {
    for (; with_imu && reading != kitti.imu.end() && reading->time <= kitti.scans[i].end; ++reading)
      take(odometry.process(Packet(*reading)));
    take(odometry.process(Packet(kitti.scans[i])));
    reference.push_back(kitti.T_world_lidar[i].translation());
  }
  if constexpr (requires { odometry.flush(); })
    while (const auto frame = odometry.flush()) take(frame);
  REQUIRE(found.size() == reference.size());
  const auto T_reference_odom = umeyama(found, reference, false);
  REQUIRE(T_reference_odom.has_value());
  double sum = 0;
  for (std::size_t i = 0; i < found.size(); ++i) sum += (*T_reference_odom * found[i] - reference[i]).squaredNorm();
  CHECK(odometry.counts().lost_scans == 0);
  return std::sqrt(sum / static_cast<double>(found.size()));
}

}  // namespace

TEST_SUITE("odometry on a real drive") {
  TEST_CASE("83 m of KITTI 00 from the first scan on, at speed" * doctest::skip(test::quick())) {
    const auto folder = test::real_data("kitti00_first101/kitti00_first101");
    if (!folder) return;
    std::vector<std::filesystem::path> files;
    for (const auto& entry : std::filesystem::directory_iterator(*folder / "velodyne_sync"))
      files.push_back(entry.path());
    std::ranges::sort(files);
    LidarOdometry<> odometry;
    std::vector<Eigen::Vector3d> found, reference;
    for (const auto& file : files) {
      const auto frame = odometry.process(Packet(read_revolution(file)));
      REQUIRE(frame.has_value());
      CHECK(frame->health.status == FrameStatus::good);
      found.push_back(frame->T_odom_body.translation());
    }
    for (const SE3d& pose : read_tum(*folder / "poses_semantickitti.tum").poses)
      reference.push_back(pose.translation());
    REQUIRE(found.size() == reference.size());
    const auto T_reference_odom = umeyama(found, reference, false);
    REQUIRE(T_reference_odom.has_value());
    double sum = 0;
    for (std::size_t i = 0; i < found.size(); ++i) sum += (*T_reference_odom * found[i] - reference[i]).squaredNorm();
    const double rms = std::sqrt(sum / static_cast<double>(found.size()));
    MESSAGE("position error ", rms, " m (rms, aligned)");
    CHECK(rms < 0.15);
    CHECK(odometry.counts().lost_scans == 0);
  }

  // Steps of 1.4 to 3.6 m, the first at an unknown speed: a gate that shrinks before the pose has come to rest loses
  // it.
  TEST_CASE("every second to fifth scan of KITTI 00: the first step is as long as any" * doctest::skip(test::quick())) {
    const auto kitti = read_kitti();
    if (!kitti) return;
    for (std::size_t n = 2; n <= 5; ++n) {
      const double lidar = error_at<LidarOdometry<>>(*kitti, n, false);
      const double inertial = error_at<LidarInertialOdometry<>>(*kitti, n, true);
      MESSAGE("one scan of ", n, ": LiDAR alone ", lidar, " m, with the inertial unit ", inertial, " m");
      CHECK(lidar < 0.12);
      CHECK(inertial < 0.12);
    }
  }
}
