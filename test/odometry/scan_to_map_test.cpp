#include "chainslam/odometry/scan_to_map.hpp"

#include <doctest/doctest.h>

#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/thread_pool.hpp"
#include "chainslam/search/kd_tree.hpp"
#include "chainslam/search/voxel_map.hpp"
#include "support/property.hpp"
#include "support/quick.hpp"
#include "support/threads_cases.hpp"
#include "support/world.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

PointCloud<float> seen_from(const World& world, const SE3d& pose, Rng& rng, double noise = 0.01, double voxel = 0.5) {
  const Spinner spinner{.noise = noise, .timed = false};
  return voxel_downsample(spinner
                              .sweep(
                                  world, 0, [&](double) { return pose; }, rng)
                              .cloud,
                          voxel);
}

VoxelMap<float> map_of(const World& world, Rng& rng, double noise = 0.01) {
  VoxelMap<float> map({.voxel_size = 1.0, .max_points_per_voxel = 8, .min_spacing = 0.35});
  for (const double x : {-1.0, 0.0, 1.0}) {
    const SE3d pose(SO3d::exp({0, 0, 0.3 * x}), {x, 0.3 * x, 0});
    map.insert(transformed(seen_from(world, pose, rng, noise), pose));
  }
  return map;
}

SE3d off_by(Rng& rng, double metres, double radians) {
  const auto in = [&](double bound) {
    return Eigen::Vector3d(rng.uniform(-bound, bound), rng.uniform(-bound, bound), rng.uniform(-bound, bound));
  };
  return SE3d(SO3d::exp(in(radians)), in(metres));
}

}  // namespace

TEST_SUITE("odometry/scan_to_map") {
  TEST_CASE("a guess within its stated error is brought home" * doctest::skip(quick())) {
    for_all(12, [](Rng& rng, int) {
      const World world = hall();
      const VoxelMap<float> map = map_of(world, rng);
      const SE3d truth(SO3d::exp({0.01, -0.02, 0.4}), {0.5, -0.3, 0.1});
      const PointCloud<float> scan = seen_from(world, truth, rng);
      const ScanMatch match = ScanToMap<>{}.align(scan, map, truth * off_by(rng, 0.5, 0.04), 1.0);
      CHECK(match.status == ScanMatchStatus::converged);
      CHECK(match.degenerate_directions == 0);
      CHECK(match.matches > to_index(scan.size()) / 2);
      const Vector6d error = truth.local(match.T_map_body);
      CHECK(error.head<3>().norm() < 0.015);
      CHECK(error.tail<3>().norm() < 0.002);
    });
  }

  TEST_CASE("moved things are not followed") {
    Rng rng(1);
    World with_van = hall();
    with_van.add_box({6, -3, 0.2}, {2.0, 1.0, 1.2});
    const VoxelMap<float> map = map_of(with_van, rng);
    World moved = hall();
    moved.add_box({6.5, -3, 0.2}, {2.0, 1.0, 1.2});  // the van drove on by half a metre
    const ScanMatch match = ScanToMap<>{}.align(seen_from(moved, SE3d(), rng), map, SE3d(), 0.3);
    CHECK(match.T_map_body.log().norm() < 0.01);
  }

  TEST_CASE("along a corridor there is noise only: the guess is kept there, and its variance reported") {
    for (const double noise : {0.005, 0.02}) {
      Rng rng(2);
      const VoxelMap<float> map = map_of(corridor(), rng, noise);
      const SE3d guess(SO3d::exp({0.005, 0.005, 0.01}), {0.4, 0.1, -0.05});
      const ScanMatch match = ScanToMap<>{}.align(seen_from(corridor(), SE3d(), rng, noise), map, guess, 0.5);
      CHECK(match.degenerate_directions == 1);
      CHECK(match.signal[0] < 2);  // one is noise alone
      CHECK(match.signal[1] > 20);
      CHECK(match.T_map_body.translation().x() == doctest::Approx(0.4).epsilon(0.05));
      CHECK(std::abs(match.T_map_body.translation().y()) < 0.02);
      CHECK(std::abs(match.T_map_body.translation().z()) < 0.02);
      CHECK(match.T_map_body.rotation().log().norm() < 0.003);
      CHECK(match.covariance(0, 0) > 0.1);  // 0.5 m, squared, less what is not along x
      CHECK(match.covariance(1, 1) < 0.001);
    }
  }

  TEST_CASE("nothing to match with: the guess, and why") {
    Rng rng(3);
    const PointCloud<float> scan = seen_from(hall(), SE3d(), rng);
    const SE3d guess(SO3d::exp({0, 0, 1}), {1, 2, 3});
    const ScanMatch empty = ScanToMap<>{}.align(scan, VoxelMap<float>{}, guess, 0.5);
    CHECK(empty.status == ScanMatchStatus::too_few_matches);
    CHECK(empty.T_map_body == guess);
    const VoxelMap<float> map = map_of(hall(), rng);
    CHECK(ScanToMap<>{}.align(PointCloud<float>{}, map, guess, 0.5).status == ScanMatchStatus::too_few_matches);
    const SE3d far(SO3d(), {500, 0, 0});
    CHECK(ScanToMap<>{}.align(scan, map, far, 0.5).T_map_body == far);
  }

  TEST_CASE("one ring and a point beside it make no plane, two rows do") {
    const chainslam::detail::PlaneRule rule{
        .max_neighbor_distance = 5, .max_deviation = 0.1, .min_width = 0.1, .least_noise = 0.01};
    const std::vector<Eigen::Vector3f> ring{
        {0, -1, 0}, {0.01F, -0.5F, 0}, {0, 0, 0.01F}, {0, 0.5F, 0}, {0.6F, 1, 0.5F}};
    const std::vector<Eigen::Vector3f> rows{
        {0, -1, 0}, {0.01F, -0.5F, 0}, {0, 0, 0.01F}, {0.6F, 0, 0}, {0.6F, 0.5F, 0}};
    const auto normal_of = [&](const std::vector<Eigen::Vector3f>& points) {
      return chainslam::detail::match_plane<5>(KdTree<float>(points), Eigen::Vector3d(0.1, 0, 0), rule).normal;
    };
    CHECK(normal_of(ring).norm() == 0);
    CHECK(std::abs(normal_of(rows).z()) > 0.99F);
  }

  THREADS_TEST_CASE("odometry/scan_to_map", "threads change no bit") {
    Rng rng(4);
    const VoxelMap<float> map = map_of(hall(), rng);
    const PointCloud<float> scan = seen_from(hall(), SE3d(), rng);
    const SE3d guess(SO3d::exp({0, 0, 0.02}), {0.2, 0.1, 0});
    const ThreadPool threads(3);
    const ScanMatch serial = ScanToMap<>{}.align(scan, map, guess, 0.5);
    const ScanMatch parallel = ScanToMap<>{}.align(scan, map, guess, 0.5, threads);
    CHECK(serial.T_map_body == parallel.T_map_body);
    CHECK(serial.covariance == parallel.covariance);
  }
}
