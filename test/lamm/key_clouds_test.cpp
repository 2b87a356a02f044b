#include "key_clouds.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <cstddef>
#include <memory>
#include <numbers>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "support/property.hpp"

namespace chainslam::lamm {
namespace {

/// A drive straight on, a frame every 0.5 m, scans at some of the frames: two points, which do not move in the map.
Drive straight_drive(Rng& rng, int frames) {
  Drive drive;
  for (int i = 0; i < frames; ++i) {
    const SE3d T(SO3d::exp({0, 0, 0.3 * std::sin(i)}), {0.5 * i, 0, 0});
    drive.odometry.times.push_back(Timestamp(seconds(0.1 * i)));
    drive.odometry.poses.push_back(T);
    if (i > 0 && rng.uniform() < 0.7) continue;
    PointCloud<float> scan;
    for (const Eigen::Vector3d& p : {Eigen::Vector3d(3, 4, 5), Eigen::Vector3d(-7, 2, 1)})
      scan.positions.push_back((T.inverse() * p).cast<float>());
    drive.scans.push_back({.frame = i, .cloud = std::make_shared<const PointCloud<float>>(scan)});
  }
  return drive;
}

double way(const Drive& drive, std::size_t scan) { return 0.5 * drive.scans[scan].frame; }

}  // namespace

TEST_SUITE("lamm/key_clouds") {
  TEST_CASE("key clouds take scans in a row, to their number and length, and start at least the spacing apart") {
    test::for_all(40, [](Rng& rng, int size) {
      const Drive drive = straight_drive(rng, 5 + 3 * size);
      const KeyCloudOptions options{.max_scans = 6, .max_length = 8, .spacing = 3};
      const auto ranges = detail::scan_ranges(drive, options);
      REQUIRE(!ranges.empty());
      CHECK(ranges.front().first == 0);
      for (std::size_t i = 0; i < ranges.size(); ++i) {
        const auto& [first, end] = ranges[i];
        REQUIRE(first < end);
        CHECK(end - first <= 6);
        CHECK(way(drive, end - 1) - way(drive, first) <= 8 + 1e-9);
        const bool takes_all =
            end == drive.scans.size() || end - first == 6 || way(drive, end) - way(drive, first) > 8 - 1e-9;
        CHECK(takes_all);
        if (i == 0) continue;
        const std::size_t last = ranges[i - 1].first;
        CHECK(way(drive, first) - way(drive, last) >= 3 - 1e-9);
        if (first > last + 1) CHECK(way(drive, first - 1) - way(drive, last) < 3 + 1e-9);
      }
    });
  }

  TEST_CASE("scans are put together where odometry has them, in the frame of the first") {
    test::for_all(20, [](Rng& rng, int /*size*/) {
      const Drive drive = straight_drive(rng, 60);
      const PointCloud<float> cloud = detail::accumulated(drive, {2, 6}, 0.25);
      REQUIRE(cloud.size() == 8);
      const SE3d T_first_map = drive.pose(drive.scans[2].frame).inverse();
      for (std::size_t i = 0; i < cloud.size(); ++i) {
        const Eigen::Vector3d expected =
            T_first_map * (i % 2 == 0 ? Eigen::Vector3d(3, 4, 5) : Eigen::Vector3d(-7, 2, 1));
        CHECK((cloud.positions[i].cast<double>() - expected).norm() < 1e-4);
      }
    });
  }

  TEST_CASE("numbers count frames through all drives, as LAMM's gaps do") {
    Rng rng(1);
    const Drive drive = straight_drive(rng, 60);
    const auto clouds = key_clouds(drive, {.spacing = 3}, {}, 1234, 10, ThreadPool(2));
    REQUIRE(clouds.size() > 3);
    for (const KeyCloud& cloud : clouds) {
      CHECK(cloud.number == (1234 + cloud.frame) / 10);
      CHECK(cloud.place);
    }
    CHECK(key_clouds(Drive{}, {}, {}, 0, 10, Serial()).empty());
  }
}

}  // namespace chainslam::lamm
