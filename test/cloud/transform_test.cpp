#include "chainslam/cloud/point_cloud.hpp"

#include <doctest/doctest.h>

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

}  // namespace
}  // namespace chainslam
