#include "chainslam/odometry/deskew.hpp"

#include <doctest/doctest.h>

#include <limits>

using namespace chainslam;

TEST_SUITE("odometry/scan_filter") {
  TEST_CASE("every reason has its count, and what is kept keeps its columns") {
    constexpr float nan = std::numeric_limits<float>::quiet_NaN(), inf = std::numeric_limits<float>::infinity();
    PointCloud<float> sweep;
    sweep.positions = {{5, 0, 0}, {nan, 0, 0}, {0, inf, 0}, {0, 0, 0}, {0.5F, 0, 0}, {0, 300, 0}, {6, 0, 0}, {7, 0, 0}};
    sweep.time_offsets = {0, 1, 2, 3, 4, 5, 6, nan};
    sweep.intensities = {10, 11, 12, 13, 14, 15, 16, 17};
    ScanFilterCounts counts;
    const PointCloud<float> kept = ScanFilter{}.apply(sweep, counts);
    CHECK(kept.positions == std::vector<Eigen::Vector3f>{{5, 0, 0}, {6, 0, 0}});
    CHECK(kept.time_offsets == std::vector<float>{0, 6});
    CHECK(kept.intensities == std::vector<float>{10, 16});
    CHECK(counts.not_finite == 3);
    CHECK(counts.zero == 1);
    CHECK(counts.near == 1);
    CHECK(counts.far == 1);
    CHECK(counts.thinned == 0);
  }

  TEST_CASE("every n-th usable point is kept") {
    PointCloud<float> sweep;
    for (int i = 1; i <= 10; ++i) sweep.positions.emplace_back(static_cast<float>(i) + 1, 0, 0);
    ScanFilterCounts counts;
    const PointCloud<float> kept = ScanFilter{.every = 4}.apply(sweep, counts);
    CHECK(kept.positions == std::vector<Eigen::Vector3f>{{2, 0, 0}, {6, 0, 0}, {10, 0, 0}});
    CHECK(counts.thinned == 7);
  }

  TEST_CASE("columns of another length are refused") {
    PointCloud<float> sweep;
    sweep.positions.assign(3, Eigen::Vector3f(5, 0, 0));
    sweep.time_offsets = {0, 0};
    ScanFilterCounts counts;
    CHECK_THROWS_AS(static_cast<void>(ScanFilter{}.apply(sweep, counts)), std::invalid_argument);
    CHECK_THROWS_AS(static_cast<void>(ScanFilter{.every = 0}.apply({}, counts)), std::invalid_argument);
  }
}
