#include <doctest/doctest.h>

#include <fstream>
#include <numbers>

#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/io/ply.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/registration/gaussian_voxel_map.hpp"
#include "chainslam/registration/icp.hpp"
#include "chainslam/search/indexed_cloud.hpp"
#include "registration/scenes.hpp"
#include "support/numbers.hpp"
#include "support/real_data.hpp"

namespace chainslam::test {
namespace {

IndexedCloud<> oriented(const PointCloud<float>& scan, double voxel_size) {
  PointCloud<float> cloud = voxel_downsample(scan, voxel_size);
  estimate_normals(cloud, {.neighbors = 10});
  return IndexedCloud<>(std::move(cloud));
}

SE3d read_transform(const std::filesystem::path& path) {
  std::ifstream file(path);
  Eigen::Matrix4d T;
  for (int i = 0; i < 16; ++i) file >> T(i / 4, i % 4);
  REQUIRE_FALSE(file.fail());
  return SE3d::from_matrix(T);
}

/// Three floats a point.
PointCloud<float> read_points(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  PointCloud<float> cloud;
  Eigen::Vector3f p;
  while (file.read(reinterpret_cast<char*>(p.data()), sizeof(p))) cloud.positions.push_back(p);
  REQUIRE_FALSE(cloud.empty());
  return cloud;
}

/// T_94_95 of KITTI's sequence 00 in the LiDAR's frame, from its ground truth and its calibration.
SE3d kitti_truth() {
  Eigen::Matrix4d T = Eigen::Matrix4d::Identity();
  T.topLeftCorner<3, 3>() << 0.999767, 0.021565, 0.000835, -0.021564, 0.999767, -0.001295, -0.000862, 0.001277,
      0.999999;
  T.topRightCorner<3, 1>() << 0.474436, -0.015082, 0.009165;
  return SE3d::from_matrix(T);
}

}  // namespace

TEST_SUITE("registration/real pairs") {
  TEST_CASE("two scans of an outdoor LiDAR, from half a metre away") {
    const auto folder = real_data("registration_pairs/small_gicp_outdoor");
    if (!folder) return;
    const SE3d truth = read_transform(*folder / "T_target_source.txt");
    const PointCloud<float> source = oriented(read_ply(*folder / "source.ply"), 0.25).cloud();
    const IndexedCloud<> target = oriented(read_ply(*folder / "target.ply"), 0.25);
    for (const AlignResult& result :
         {PointToPlaneIcp{}.align(source, target, SE3d()),
          PointToPlaneIcp{.max_distance = 2}.align(source, target, SE3d()), align(source, target, SE3d()),
          PointToPointIcp{}.align(source, target, SE3d()), Gicp{}.align(source, target, SE3d())}) {
      CHECK(result.status == AlignStatus::converged);
      CHECK(translation_error(truth, result.T_target_source) < 0.05);
      CHECK(rotation_error(truth, result.T_target_source) < 0.4 * degree);
      CHECK(result.inlier_ratio > 0.9);
      CHECK(result.mean_squared_error < 0.3);  // the paper's threshold
    }
    GaussianVoxelMap voxels;
    voxels.insert(target.cloud());
    const AlignResult result = Vgicp{}.align(source, voxels, SE3d());
    CHECK(result.status == AlignStatus::converged);
    CHECK(translation_error(truth, result.T_target_source) < 0.05);
    CHECK(rotation_error(truth, result.T_target_source) < 0.5 * degree);
  }

  TEST_CASE("a scan of KITTI 07 against the four before it, from 0.65 m and 3 degrees away") {
    const auto folder = real_data("registration_pairs/gtsam_points/kitti_07_dump");
    if (!folder) return;
    std::ifstream file(*folder / "graph.txt");
    std::vector<SE3d> poses;
    std::string name;
    Eigen::Vector3d t;
    Eigen::Quaterniond q;
    while (poses.size() < 5 && file >> name >> t[0] >> t[1] >> t[2] >> q.x() >> q.y() >> q.z() >> q.w())
      poses.emplace_back(SO3d::from_quaternion(q), t);
    REQUIRE(poses.size() == 5);
    PointCloud<float> submap;
    for (std::size_t i = 0; i < 4; ++i) {
      const PointCloud<float> part = read_points(*folder / ("00000" + std::to_string(i)) / "points.bin");
      for (const Eigen::Vector3f& p : part.positions)
        submap.positions.emplace_back((poses[0].inverse() * poses[i] * p.cast<double>().eval()).cast<float>());
    }
    const SE3d truth = poses[0].inverse() * poses[4];
    Vector6d away;
    away << 0.5, 0.4, 0.1, 0, 0, 0.05;
    const SE3d guess = truth * SE3d::exp(away);
    const IndexedCloud<> target = oriented(submap, 0.25);
    const PointCloud<float> scan = oriented(read_points(*folder / "000004/points.bin"), 0.25).cloud();
    const AlignResult result = Gicp{.max_distance = 2.0}.align(scan, target, guess);
    CHECK(result.status == AlignStatus::converged);
    CHECK(translation_error(truth, result.T_target_source) < 0.04);  // small_gicp: 0.036 m, 0.085 degrees
    CHECK(rotation_error(truth, result.T_target_source) < 0.12 * degree);
    GaussianVoxelMap voxels;
    voxels.insert(target.cloud());
    const AlignResult coarse = Vgicp{.max_distance = 2.0}.align(scan, voxels, guess);
    CHECK(coarse.status == AlignStatus::converged);
    CHECK(translation_error(truth, coarse.T_target_source) < 0.05);
    CHECK(rotation_error(truth, coarse.T_target_source) < 0.2 * degree);
  }

  TEST_CASE("two scans of KITTI, and back again") {
    const auto folder = real_data("registration_pairs/kitti00_094_095");
    if (!folder) return;
    const SE3d truth = kitti_truth();
    const PointCloud<float> scan_94 = read_kitti_bin(*folder / "000094.bin");
    const PointCloud<float> scan_95 = read_kitti_bin(*folder / "000095.bin");
    const IndexedCloud<> target_94 = oriented(scan_94, 0.5);
    const IndexedCloud<> target_95 = oriented(scan_95, 0.5);
    const AlignResult forth = PointToPlaneIcp{}.align(target_95.cloud(), target_94, SE3d());
    const AlignResult back = PointToPlaneIcp{}.align(target_94.cloud(), target_95, SE3d());
    CHECK(forth.status == AlignStatus::converged);
    CHECK(back.status == AlignStatus::converged);
    CHECK(translation_error(truth, forth.T_target_source) < 0.02);
    CHECK(rotation_error(truth, forth.T_target_source) < 0.1 * degree);
    CHECK(translation_error(SE3d(), forth.T_target_source * back.T_target_source) < 0.02);
    CHECK(rotation_error(SE3d(), forth.T_target_source * back.T_target_source) < 0.1 * degree);
  }
}

}  // namespace chainslam::test
