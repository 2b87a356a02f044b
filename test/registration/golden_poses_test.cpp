#include <doctest/doctest.h>

#include <fstream>
#include <map>
#include <string>

#include "chainslam/features/normals.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/registration/icp.hpp"

namespace chainslam {
namespace {

/// Two clouds of a made corner, and how PCL and Open3D align them (bench/registration/golden_values.cpp writes it).
struct GoldenPoses {
  std::map<std::string, SE3d> T_target_source;
  PointCloud<float> source, target;  ///< with normals
};

GoldenPoses read_golden_poses() {
  std::ifstream file(std::string(CHAINSLAM_SOURCE_DIR) + "/test/registration/golden/corner_poses.txt");
  std::string line, name;
  while (file.peek() == '#') std::getline(file, line);
  GoldenPoses golden;
  while (file >> name && name != "source") {
    Eigen::Matrix4d T = Eigen::Matrix4d::Identity();
    for (Eigen::Index row = 0; row < 3; ++row)
      for (Eigen::Index column = 0; column < 4; ++column) file >> T(row, column);
    golden.T_target_source.emplace(
        name, SE3d(SO3d::from_matrix(Eigen::Matrix3d(T.topLeftCorner<3, 3>())), T.topRightCorner<3, 1>()));
  }
  for (PointCloud<float>* cloud : {&golden.source, &golden.target}) {
    std::size_t count = 0;
    file >> count;
    cloud->positions.resize(count);
    for (Eigen::Vector3f& p : cloud->positions) file >> p[0] >> p[1] >> p[2];
    REQUIRE(file.good());
    estimate_normals(*cloud, {.neighbors = 10}, {2, 2, 3});
    file >> name;
  }
  REQUIRE(golden.T_target_source.size() == 5);
  return golden;
}

TEST_SUITE("registration/golden_poses") {
  TEST_CASE("point to plane comes to where PCL and Open3D do") {
    const GoldenPoses golden = read_golden_poses();
    const PointToPlaneIcp icp{.max_iterations = 100, .max_distance = 0.5};
    const AlignResult result = icp.align(golden.source, IndexedCloud<>(golden.target), SE3d());
    for (const char* peer : {"pcl_plane", "open3d_plane"}) {
      CAPTURE(peer);
      const Vector6d away = (golden.T_target_source.at(peer).inverse() * result.T_target_source).log();
      // PCL computes in float and stops at steps of 1e-3; both agree with one another to 1e-6.
      CHECK(away.head<3>().norm() < 1e-3);
      CHECK(away.tail<3>().norm() < 1e-3);
    }
  }

  TEST_CASE("GICP is as near the truth as PCL's and Open3D's") {
    const GoldenPoses golden = read_golden_poses();
    const Gicp icp{.max_iterations = 100, .max_distance = 0.5};
    const AlignResult result = icp.align(golden.source, IndexedCloud<>(golden.target), SE3d());
    const auto error = [&](const SE3d& pose) {
      return (golden.T_target_source.at("truth").inverse() * pose).log().head<3>().norm();
    };
    CHECK(error(result.T_target_source) < error(golden.T_target_source.at("pcl_gicp")));
    // Its covariances are those of 20 neighbours, ours discs along normals of 10.
    CHECK(error(result.T_target_source) < 2 * error(golden.T_target_source.at("open3d_gicp")));
  }
}

}  // namespace
}  // namespace chainslam
