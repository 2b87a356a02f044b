#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "chainslam/io/tum.hpp"
#include "chainslam/lie/umeyama.hpp"
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
}
