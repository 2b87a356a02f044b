#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <memory>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/io/pcd.hpp"
#include "chainslam/io/ply.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/registration/feature_registration.hpp"
#include "chainslam/slam/submap.hpp"
#include "registration/scenes.hpp"
#include "support/numbers.hpp"
#include "support/quick.hpp"
#include "support/real_data.hpp"

namespace chainslam::test {
namespace {

/// The range of figures over pairs of one kind, and how many were found.
struct Figures {
  int pairs = 0, found = 0;
  double least_fitness = 1e9, most_fitness = 0, least_ratio = 1e9, most_ratio = 0;

  void add(const GlobalAlignResult& result) {
    ++pairs;
    if (!result.found()) return;
    ++found;
    least_fitness = std::min(least_fitness, result.fitness_target);
    most_fitness = std::max(most_fitness, result.fitness_target);
    least_ratio = std::min(least_ratio, result.putative_ratio);
    most_ratio = std::max(most_ratio, result.putative_ratio);
  }
  void print(const char* name) const {
    std::printf("FIGURE %s: %d of %d found", name, found, pairs);
    if (found > 0)
      std::printf(", fitness_target %.2f to %.2f, putative_ratio %.3f to %.3f", least_fitness, most_fitness,
                  least_ratio, most_ratio);
    std::printf("\n");
  }
};

SE3d read_matrix(const std::filesystem::path& path) {
  std::ifstream file(path);
  Eigen::Matrix4d T;
  for (int i = 0; i < 16; ++i) file >> T(i / 4, i % 4);
  REQUIRE_FALSE(file.fail());
  return SE3d::from_matrix(T);
}

/// Turned about the sensor by more than any guess would bear.
SE3d turn() { return SE3d(SO3d::exp(Eigen::Vector3d(0.1, -0.05, 2.2)), Eigen::Vector3d::Zero()); }

/// Five submaps of KITTI 07, from 3 to 28 m apart, and their poses.
struct PosedClouds {
  std::vector<PointCloud<float>> clouds;
  std::vector<SE3d> poses;
};

PosedClouds read_kitti_07(const std::filesystem::path& folder) {
  PosedClouds read;
  std::ifstream graph(folder / "graph.txt");
  std::string name;
  double x, y, z, qx, qy, qz, qw;
  for (int i = 0; graph >> name >> x >> y >> z >> qx >> qy >> qz >> qw; ++i) {
    read.poses.emplace_back(SO3d::from_quaternion(SO3d::Quaternion(Eigen::Vector4d(qx, qy, qz, qw).normalized())),
                            Eigen::Vector3d(x, y, z));
    std::ifstream file(folder / ("00000" + std::to_string(i)) / "points.bin", std::ios::binary);
    PointCloud<float>& cloud = read.clouds.emplace_back();
    std::array<float, 3> p;
    while (file.read(reinterpret_cast<char*>(p.data()), sizeof p)) cloud.positions.emplace_back(p[0], p[1], p[2]);
    REQUIRE_FALSE(cloud.empty());
  }
  REQUIRE(read.poses.size() == 5);
  return read;
}

/// Keyframes of a walk whose scans are read when a submap wants them.
class LazyWalk {
 public:
  LazyWalk(std::filesystem::path folder, const SE3d& T_map_odom) : folder_(std::move(folder)) {
    for (const SE3d& pose : read_kitti_poses(folder_ / "odom_poses.txt").poses) {
      Keyframe& keyframe = keyframes_.emplace_back();
      keyframe.session = SessionId{0};
      keyframe.T_map_body = T_map_odom * pose;
    }
  }

  [[nodiscard]] Index size() const { return to_index(keyframes_.size()); }
  [[nodiscard]] const SE3d& pose(Index i) const { return keyframes_[static_cast<std::size_t>(i)].T_map_body; }

  [[nodiscard]] PointCloud<float> submap(Index center, Index before, Index after) {
    const SubmapRange range{std::max(center - before, Index{0}), std::min(center + after + 1, size())};
    for (Index i = range.begin; i < range.end; ++i) {
      KeyframeScan& cloud = keyframes_[static_cast<std::size_t>(i)].cloud;
      const std::string number = std::to_string(i);
      const std::string file = std::string(6 - number.size(), '0') + number + ".pcd";
      if (!cloud) cloud = std::make_shared<PointCloud<float>>(read_pcd(folder_ / "Scans" / file));
    }
    return assemble_submap(keyframes_, KeyframeId{center}, range, 0.4);
  }

 private:
  std::filesystem::path folder_;
  std::vector<Keyframe> keyframes_;
};

}  // namespace

TEST_SUITE("registration/real pairs without a guess") {
  TEST_CASE("two scans of an outdoor LiDAR, one of them turned round") {
    const auto folder = real_data("registration_pairs/small_gicp_outdoor");
    if (!folder) return;
    const SE3d truth = read_matrix(*folder / "T_target_source.txt") * turn().inverse();
    const PointCloud<float> source = transformed(read_ply(*folder / "source.ply"), turn());
    const PointCloud<float> target = read_ply(*folder / "target.ply");
    const GlobalAlignResult forth = FeatureRegistration<>{}.align(source, target);
    const GlobalAlignResult back = FeatureRegistration<>{}.align(target, source);
    std::printf("FIGURE small_gicp_outdoor: fitness_target %.2f, putative_ratio %.2f, %.2f m and %.1f deg off\n",
                forth.fitness_target, forth.putative_ratio, translation_error(truth, forth.T_target_source),
                rotation_error(truth, forth.T_target_source) / degree);
    for (const SE3d& T : {forth.T_target_source, back.T_target_source.inverse()}) {
      CHECK(translation_error(truth, T) < 0.5);  // half a voxel
      CHECK(rotation_error(truth, T) < 3 * degree);
    }
    CHECK(forth.fitness_target > 0.7);
    CHECK(forth.putative_ratio > 0.4);
  }

  TEST_CASE("submaps of KITTI 07: neighbours are found, strangers are not" * doctest::skip(quick())) {
    const auto folder = real_data("registration_pairs/gtsam_points/kitti_07_dump");
    const auto other = real_data("registration_pairs/small_gicp_outdoor");
    if (!folder || !other) return;
    const FeatureRegistration<> registration;
    const PosedClouds places = read_kitti_07(*folder);
    std::vector<DescribedCloud> described;
    for (const PointCloud<float>& cloud : places.clouds) described.push_back(registration.describe(cloud));
    Figures near, far;
    for (std::size_t i = 0; i < described.size(); ++i)
      for (std::size_t j = 0; j < described.size(); ++j) {
        const SE3d truth = places.poses[j].inverse() * places.poses[i];
        if (i == j || truth.translation().norm() > 13) continue;
        CAPTURE(i);
        CAPTURE(j);
        const GlobalAlignResult result = registration.align(described[i], described[j]);
        near.add(result);
        REQUIRE(result.found());
        CHECK(translation_error(truth, result.T_target_source) < 1.0);
        CHECK(rotation_error(truth, result.T_target_source) < 5 * degree);
      }
    const DescribedCloud stranger = registration.describe(read_ply(*other / "target.ply"));
    for (const DescribedCloud& place : described)
      for (const auto& result : {registration.align(place, stranger), registration.align(stranger, place)})
        far.add(result);
    near.print("KITTI 07, 3 to 12 m apart");
    far.print("KITTI 07 and another town");
    CHECK(near.pairs == 10);
    CHECK(near.least_fitness > 0.45);
    CHECK(near.least_ratio > 0.05);
    CHECK(far.found == 0);
  }

  TEST_CASE("two walks of a courtyard: half a submap is found in a whole one, and not in another town" *
            doctest::skip(quick())) {
    const auto folder = real_data("hku_square_two_sessions");
    const auto other = real_data("registration_pairs/gtsam_points/kitti_07_dump");
    if (!folder || !other) return;
    const FeatureRegistration<> registration;
    LazyWalk old_walk(*folder / "session1", SE3d()),
        new_walk(*folder / "session2", read_matrix(*folder / "T_session1_session2.txt"));
    std::vector<DescribedCloud> strangers;
    for (const PointCloud<float>& cloud : read_kitti_07(*other).clouds)
      strangers.push_back(registration.describe(cloud));
    constexpr Index radius = 20;
    Figures here, elsewhere;
    for (Index i = radius; i < new_walk.size(); i += 41) {
      Index nearest = radius;
      const auto distance = [&](Index j) {
        return (old_walk.pose(j).translation() - new_walk.pose(i).translation()).norm();
      };
      for (Index j = radius; j < old_walk.size() - radius; ++j)
        if (distance(j) < distance(nearest)) nearest = j;
      CAPTURE(i);
      CAPTURE(nearest);
      const DescribedCloud source = registration.describe(new_walk.submap(i, radius, 0));
      const DescribedCloud target = registration.describe(old_walk.submap(nearest, radius, radius));
      const SE3d truth = old_walk.pose(nearest).inverse() * new_walk.pose(i);
      const GlobalAlignResult result = registration.align(source, target);
      here.add(result);
      REQUIRE(result.found());
      CHECK(translation_error(truth, result.T_target_source) < 0.7);
      CHECK(rotation_error(truth, result.T_target_source) < 3 * degree);
      for (const DescribedCloud& stranger : strangers)
        for (const auto& wrong : {registration.align(source, stranger), registration.align(stranger, target)})
          elsewhere.add(wrong);
    }
    here.print("courtyard, second walk in the first");
    elsewhere.print("courtyard and another town");
    CHECK(here.least_fitness > 0.3);
    CHECK(here.least_ratio > 0.1);
    CHECK(elsewhere.found == 0);
  }

  TEST_CASE("two views of a room from a depth camera, forth and back") {
    const auto folder = real_data("registration_pairs/teaser_3dmatch");
    if (!folder) return;
    const FeatureRegistration<> registration{.voxel_size = 0.05,
                                             .normals = {.neighbors = 30, .radius = 0.1},
                                             .features = {.radius = 0.25},
                                             .estimator = {.max_distance = 0.05}};
    const DescribedCloud a = registration.describe(read_ply(*folder / "cloud_bin_0.ply"));
    const DescribedCloud b = registration.describe(read_ply(*folder / "cloud_bin_4.ply"));
    const GlobalAlignResult forth = registration.align(a, b), back = registration.align(b, a);
    REQUIRE(forth.found());
    REQUIRE(back.found());
    // No reference is known: the two answers must be each other's inverse, and each lay half of its source on the
    // target.
    CHECK(translation_error(SE3d(), forth.T_target_source * back.T_target_source) < 0.1);
    CHECK(rotation_error(SE3d(), forth.T_target_source * back.T_target_source) < 3 * degree);
    CHECK(forth.fitness_source > 0.4);
    CHECK(back.fitness_source > 0.4);
  }
}

}  // namespace chainslam::test
