#include "simulator/town_drive.hpp"

#include <doctest/doctest.h>

#include <set>

#include "simulator/rig.hpp"

namespace chainslam::simulator {
namespace {

/// The small town with a tenth of the rays.
Preset coarse_preset() {
  Preset quick = *preset("town-small");
  quick.lidar.firings_per_revolution = 60;
  return quick;
}

}  // namespace

TEST_SUITE("simulator/town_drive") {
  TEST_CASE("packets come in time order, all of them") {
    TownDrive drive(coarse_preset(), 1);
    std::array<std::size_t, 3> counts{};
    Timestamp previous = drive.epoch();
    while (const auto packet = drive.next()) {
      CHECK(available_at(*packet) >= previous);
      previous = available_at(*packet);
      ++counts[packet->index()];
      if (const auto* scan = std::get_if<LidarScan>(&*packet)) CHECK(scan->cloud.size() > 1000);
      if (const auto* fix = std::get_if<GnssFix>(&*packet)) CHECK(fix->quality == GnssQuality::three_dimensional);
    }
    CHECK(counts[0] == drive.imu().size());
    CHECK(counts[1] == static_cast<std::size_t>(drive.scan_count()));
    CHECK(counts[2] > 20);
    CHECK(drive.scan_count() > 200);
    CHECK_FALSE(drive.next());
  }

  TEST_CASE("the same seed gives the same scans in any order, another seed another town") {
    const TownDrive a(coarse_preset(), 7);
    TownDrive b(coarse_preset(), 7);
    const TownDrive other(coarse_preset(), 8);
    const LidarScan late = a.scan(100);
    CHECK(a.scan(30).cloud.positions == b.scan(30).cloud.positions);
    CHECK(late.cloud.positions == b.scan(100).cloud.positions);
    CHECK(late.cloud.positions != other.scan(100).cloud.positions);
    CHECK(a.imu()[500].gyro == b.imu()[500].gyro);
  }

  TEST_CASE("the truth puts scans of one place from two visits upon each other") {
    TownDrive drive(*preset("town-small"), 3);
    const SE3d T_body_lidar = drive.lidar().true_T_body_lidar();
    const auto cell_of = [](const Eigen::Vector3d& p) {
      const Eigen::Vector3d q = (p / 0.5).array().floor();
      return std::array<int, 3>{static_cast<int>(q.x()), static_cast<int>(q.y()), static_cast<int>(q.z())};
    };
    const auto cells_of = [&](Index index) {
      std::set<std::array<int, 3>> cells;
      const LidarScan scan = drive.scan(index);
      for (std::size_t i = 0; i < scan.cloud.size(); ++i) {
        if (scan.cloud.positions[i].norm() > 20.0F) continue;
        const Timestamp time = scan.time + seconds(static_cast<double>(scan.cloud.time_offsets[i]));
        cells.insert(cell_of(drive.truth(time) * (T_body_lidar * scan.cloud.positions[i].cast<double>())));
      }
      return cells;
    };
    const auto first = cells_of(2);
    const auto last = cells_of(drive.scan_count() - 3);
    std::size_t common = 0;
    for (const auto& cell : last) common += first.contains(cell) ? 1 : 0;
    CHECK(static_cast<double>(common) / static_cast<double>(last.size()) > 0.6);
  }

  TEST_CASE("the vehicle never drives through anything") {
    struct Tried {
      const char* name;
      std::size_t session;
    };
    for (const Tried& tried : {Tried{"town", 0}, Tried{"town-small", 0}, Tried{"town-sessions", 0},
                               Tried{"town-sessions", 1}, Tried{"town-sessions", 2}})
      for (const std::uint64_t seed : {1U, 2U, 3U}) {
        CAPTURE(tried.name);
        CAPTURE(tried.session);
        CAPTURE(seed);
        const TownDrive drive(*preset(tried.name), seed, tried.session);
        for (double t = 0.0; t < drive.drive().duration(); t += 0.1) {
          const SE3d T = drive.drive().pose(t);
          // Feelers at half the body's height, ahead and to both sides: 1 m beyond the vehicle's outline is free.
          for (const Eigen::Vector3d& feeler : {Eigen::Vector3d(2.0, 0.0, 0.0), Eigen::Vector3d(0.0, 1.0, 0.0),
                                                Eigen::Vector3d(0.0, -1.0, 0.0), Eigen::Vector3d(0.0, 0.0, 1.0)}) {
            const Eigen::Vector3d direction = T.rotation() * feeler.normalized();
            for (const double height : {-0.8, 0.0}) {
              const Eigen::Vector3d start = T * Eigen::Vector3d(0.0, 0.0, height);
              CHECK_FALSE(drive.caster().cast(
                  {start.cast<float>(), direction.cast<float>().normalized(), static_cast<float>(feeler.norm())}));
            }
          }
        }
      }
  }

  TEST_CASE("truth at scan ends and at inertial samples has a pose for each") {
    const TownDrive drive(coarse_preset(), 1);
    const Trajectory scans = drive.truth_at_scan_ends();
    REQUIRE(scans.size() == static_cast<std::size_t>(drive.scan_count()));
    CHECK(scans.times[5] == drive.scan(5).end);
    CHECK(scans.poses[5] == drive.truth(scans.times[5]));
    CHECK(drive.truth_at_imu_rate().size() == drive.imu().size());
  }

  TEST_CASE("presets are known by name") {
    for (const std::string_view name : preset_names()) {
      REQUIRE(preset(name));
      CHECK(preset(name)->name == name);
    }
    CHECK_FALSE(preset("village"));
  }
}

}  // namespace chainslam::simulator
