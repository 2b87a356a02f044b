#include "chainslam/registration/alignment_checks.hpp"

#include <doctest/doctest.h>

#include <numbers>
#include <stdexcept>

#include "chainslam/cloud/point_cloud.hpp"

namespace chainslam {
namespace {

constexpr FreeSpaceOptions all_points{.max_points = 1'000'000};

/// An upright wall across the x axis, 12 m wide and 6 m high about it, a point every 10 cm.
PointCloud<float> wall_at(float x) {
  PointCloud<float> wall;
  for (int y = -60; y <= 60; ++y)
    for (int z = -30; z <= 30; ++z)
      wall.positions.emplace_back(x, 0.1F * static_cast<float>(y), 0.1F * static_cast<float>(z));
  return wall;
}

}  // namespace

TEST_SUITE("registration/free_space") {
  TEST_CASE("points before what was seen are seen through, those on it are confirmed, those behind it are hidden") {
    const FreeSpace view(wall_at(10), Eigen::Vector3d::Zero(), all_points);
    const PointCloud<float> before = wall_at(5), on = wall_at(9.2F), behind = wall_at(15);
    // Seen from the origin the nearer wall is twice as wide: only its middle is in view.
    const FreeSpaceCount of_before = view.count(before, SE3d());
    CHECK(of_before.in_view < static_cast<Index>(before.size()));
    CHECK(of_before.in_view > static_cast<Index>(before.size()) / 5);
    CHECK(of_before.share() == 1);
    CHECK(of_before.contradiction() == 1);
    CHECK(view.count(on, SE3d()).share() == 0);
    CHECK(view.count(on, SE3d()).contradiction() == 0);
    const FreeSpaceCount of_behind = view.count(behind, SE3d());
    CHECK(of_behind.in_view == static_cast<Index>(behind.size()));
    CHECK(of_behind.share() == 0);
    CHECK(of_behind.confirmed == 0);
    CHECK(of_behind.contradiction() == 0);  // nothing speaks against it
  }

  TEST_CASE("the margin grows with the range, and what is too far off is not looked at") {
    const FreeSpace view(wall_at(10), Eigen::Vector3d::Zero(), {.margin = 1, .margin_ratio = 0.05});
    CHECK(view.count(wall_at(8.6F), SE3d()).share() < 0.01);  // 1 m and a twentieth of 10 m; more to the side
    CHECK(view.count(wall_at(8.0F), SE3d()).share() > 0.5);
    const FreeSpace near(wall_at(10), Eigen::Vector3d::Zero(), {.max_range = 7.9});
    CHECK(near.count(wall_at(8.0F), SE3d()).in_view == 0);
  }

  TEST_CASE("one point of many tells as much as all of them") {
    const PointCloud<float> wall = wall_at(8.5F);
    const FreeSpace whole(wall_at(10), {0, 8, 0}, all_points), some(wall_at(10), {0, 8, 0}, {.max_points = 700});
    const FreeSpaceCount of_all = whole.count(wall, SE3d()), of_some = some.count(wall, SE3d());
    CHECK(of_some.in_view <= 700);
    CHECK(of_some.in_view > 300);
    CHECK(of_some.contradiction() == doctest::Approx(of_all.contradiction()).epsilon(0.1));
  }

  TEST_CASE("the sensor stands where it is said to, and points come from their own frame") {
    const SE3d T_seen_points(SO3d::exp({0, 0, std::numbers::pi}), {0, 0, 0});
    const FreeSpace from_within(wall_at(10), {7, 0, 0}, all_points);
    CHECK(from_within.count(wall_at(5), SE3d()).in_view == 0);  // behind its back
    CHECK(from_within.count(wall_at(-9.6F), T_seen_points).seen_through == 0);
    CHECK(from_within.count(wall_at(-8), T_seen_points).seen_through > 500);  // 1 m off, 2 m before the wall
  }

  TEST_CASE("where nothing was seen nothing is known") {
    const FreeSpace blind(PointCloud<float>{}, Eigen::Vector3d::Zero());
    CHECK(blind.count(wall_at(5), SE3d()).in_view == 0);
    CHECK(blind.count(wall_at(5), SE3d()).share() == 0);
    CHECK(blind.count(wall_at(5), SE3d()).contradiction() == 0);
    CHECK_THROWS_AS((FreeSpace(wall_at(5), Eigen::Vector3d::Zero(), {.cell = 0})), std::invalid_argument);
    CHECK_THROWS_AS((FreeSpace(wall_at(5), Eigen::Vector3d::Zero(), {.margin = -1})), std::invalid_argument);
    CHECK_THROWS_AS((FreeSpace(wall_at(5), Eigen::Vector3d::Zero(), {.max_points = 0})), std::invalid_argument);
  }
}

}  // namespace chainslam
