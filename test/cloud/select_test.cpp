#include "chainslam/cloud/point_cloud.hpp"

#include <doctest/doctest.h>

#include <vector>

namespace chainslam {
namespace {

TEST_SUITE("cloud/select") {
  TEST_CASE("takes the points asked for, in that order and again if asked twice, with all columns") {
    PointCloud<float> cloud;
    cloud.positions = {{1, 0, 0}, {0, 2, 0}, {0, 0, 3}};
    cloud.normals = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    cloud.time_offsets = {0.0f, 0.1f, 0.2f};
    cloud.intensities = {1, 2, 3};
    const PointCloud<float> chosen = select(cloud, std::vector<Index>{2, 0, 2});
    CHECK(chosen.positions == std::vector<Eigen::Vector3f>{{0, 0, 3}, {1, 0, 0}, {0, 0, 3}});
    CHECK(chosen.normals == std::vector<Eigen::Vector3f>{{0, 0, 1}, {1, 0, 0}, {0, 0, 1}});
    CHECK(chosen.time_offsets == std::vector<float>{0.2f, 0.0f, 0.2f});
    CHECK(chosen.intensities == std::vector<float>{3, 1, 3});
  }

  TEST_CASE("nothing asked for gives nothing; columns that are not there stay empty") {
    const std::vector<Eigen::Vector3d> points{{0.1, 0, 0}, {0.2, 0, 0}};
    CHECK(select(points, std::vector<Index>{}).empty());
    const PointCloud<double> chosen = select<double>(points, std::vector<Index>{1});
    CHECK(chosen.positions == std::vector<Eigen::Vector3d>{{0.2, 0, 0}});
    CHECK_FALSE((chosen.has_normals() || chosen.has_times() || chosen.has_intensities()));
  }
}

}  // namespace
}  // namespace chainslam
