#include "chainslam/cloud/transform.hpp"

#include <doctest/doctest.h>

#include <limits>

#include "chainslam/cloud/crop.hpp"

namespace chainslam {
namespace {

PointCloud<float> three_points() {
  PointCloud<float> cloud;
  cloud.positions = {{1, 0, 0}, {0, 2, 0}, {0, 0, 3}};
  cloud.normals = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  cloud.time_offsets = {0.0f, 0.1f, 0.2f};
  cloud.intensities = {1, 2, 3};
  return cloud;
}

TEST_SUITE("cloud/transform") {
  TEST_CASE("positions move, normals turn, other columns stay") {
    // A quarter turn about z takes x to y.
    const SE3d T_a_b(SO3d::exp(Eigen::Vector3d(0, 0, std::acos(-1.0) / 2)), Eigen::Vector3d(10, 20, 30));
    const PointCloud<float> moved = transformed(three_points(), T_a_b);
    REQUIRE(moved.size() == 3);
    CHECK((moved.positions[0] - Eigen::Vector3f(10, 21, 30)).norm() < 1e-5f);
    CHECK((moved.positions[1] - Eigen::Vector3f(8, 20, 30)).norm() < 1e-5f);
    CHECK((moved.normals[0] - Eigen::Vector3f(0, 1, 0)).norm() < 1e-6f);
    CHECK((moved.normals[2] - Eigen::Vector3f(0, 0, 1)).norm() < 1e-6f);
    CHECK(moved.time_offsets == three_points().time_offsets);
    CHECK(moved.intensities == three_points().intensities);
  }

  TEST_CASE("a bare vector of points gives a cloud without further columns") {
    const std::vector<Eigen::Vector3d> points{{1e6, 0, 0}};
    const PointCloud<float> moved = transformed(points, SE3d(SO3d(), Eigen::Vector3d(-1e6 + 0.125, 0, 0)));
    CHECK(moved.positions[0] == Eigen::Vector3f(0.125f, 0, 0));  // the sum is formed in double
    CHECK_FALSE(moved.has_normals());
    CHECK_FALSE(moved.has_times());
    CHECK(transformed(std::vector<Eigen::Vector3f>{}, SE3d()).empty());
  }
}

TEST_SUITE("cloud/crop") {
  TEST_CASE("range keeps the closed ring, with all columns") {
    const PointCloud<float> ring = crop_range(three_points(), 2.0, 3.0);
    REQUIRE(ring.size() == 2);
    CHECK(ring.positions[0] == Eigen::Vector3f(0, 2, 0));
    CHECK(ring.normals[1] == Eigen::Vector3f(0, 0, 1));
    CHECK(ring.time_offsets[0] == 0.1f);
    CHECK(ring.intensities[1] == 3);
  }

  TEST_CASE("a box splits the finite points in two") {
    PointCloud<float> cloud;
    const float nan = std::numeric_limits<float>::quiet_NaN();
    cloud.positions = {{0, 0, 0}, {1, 1, 1}, {1.5f, 0, 0}, {nan, 0, 0}};
    const Eigen::AlignedBox3d box(Eigen::Vector3d(0, 0, 0), Eigen::Vector3d(1, 1, 1));
    CHECK(crop_box(cloud, box).positions == std::vector<Eigen::Vector3f>{{0, 0, 0}, {1, 1, 1}});
    CHECK(crop_outside_box(cloud, box).positions == std::vector<Eigen::Vector3f>{{1.5f, 0, 0}});
  }

  TEST_CASE("NaN and infinite points are in no range") {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    const float inf = std::numeric_limits<float>::infinity();
    const std::vector<Eigen::Vector3f> points{{nan, 0, 0}, {inf, 0, 0}, {3, 4, 0}};
    const double all = std::numeric_limits<double>::infinity();
    CHECK(crop_range(points, 0, all).size() == 1);
  }
}

}  // namespace
}  // namespace chainslam
