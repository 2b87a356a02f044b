#include "chainslam/odometry/detail/translation_search.hpp"

#include <doctest/doctest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <limits>
#include <numbers>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/odometry/scan_to_map.hpp"
#include "chainslam/search/voxel_map.hpp"
#include "support/property.hpp"
#include "support/world.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

/// A street along x: houses of all widths, and cars parked every 6 m, each of which looks like the next.
World street(Rng& rng) {
  World world;
  world.panels.push_back({{0, 0, 0}, {80, 0, 0}, {0, 40, 0}});
  for (const double side : {-1.0, 1.0}) {
    for (double x = -70; x < 70;) {
      const double half_width = rng.uniform(3, 9);
      world.add_box({x + half_width, side * (rng.uniform(8, 10) + 5), 4}, {half_width, 5, rng.uniform(3, 6)});
      x += 2 * half_width + rng.uniform(0, 6);
    }
    for (double x = -66; x < 70; x += 6) world.add_box({x, side * 5, 0.75}, {2.1, 0.9, 0.75});
  }
  return world;
}

/// In the body's frame, whose axes lie turned by R_lidar_body in an upright LiDAR.
PointCloud<float> scan_at(const World& world, const SE3d& T_world_lidar, const SO3d& R_lidar_body, Rng& rng) {
  const Spinner spinner{.rings = 32, .columns = 240, .noise = 0.02, .timed = false};
  const PointCloud<float> scan = spinner
                                     .sweep(
                                         world, 0, [&](double) { return T_world_lidar; }, rng)
                                     .cloud;
  return voxel_downsample(transformed(scan, SE3d(R_lidar_body.inverse(), Eigen::Vector3d::Zero())), 0.5);
}

}  // namespace

TEST_SUITE("odometry/translation_search") {
  TEST_CASE("finds where a scan lies among cars parked alike, whatever is down and wherever the grid is centred") {
    for_all(12, [](Rng& rng, int) {
      const World world = street(rng);
      const SE3d first(SO3d::exp({0, 0, rng.uniform(-0.3, 0.3)}), {0, rng.uniform(-1, 1), 1.8});
      const SE3d step(SO3d(), {rng.uniform(-5, 5), rng.uniform(-1.5, 1.5), 0});
      const SO3d R = SO3d::exp({rng.uniform(-2, 2), rng.uniform(-2, 2), rng.uniform(-2, 2)});
      VoxelMap<float> map(chainslam::detail::half_metre_apart<VoxelMapOptions>());
      map.insert(scan_at(world, first, R, rng));
      const PointCloud<float> scan = voxel_downsample(scan_at(world, first * step, R, rng), 0.75);
      const SE3d truth(SO3d(), R.inverse() * step.translation());

      const ScanToMap<> rule;
      const chainslam::detail::TranslationSearch search{.reach = 6};
      // As odometry does: from where registration ends, about where the body was.
      const SE3d guess = rule.align(scan, map, SE3d(), 4).T_map_body;
      const std::vector<SE3d> found = search(scan, map, rule.plane_rule(1), guess, Eigen::Vector3d::Zero(), Serial{});
      REQUIRE(!found.empty());
      CHECK(found.size() <= search.max_found);
      double nearest = std::numeric_limits<double>::infinity();
      ScanMatch best;
      for (const SE3d& T : found) {
        nearest = std::min(nearest, (T.translation() - truth.translation()).norm());
        const ScanMatch match = rule.align(scan, map, T, search.spacing);
        if (match.weight > best.weight) best = match;
      }
      CHECK(nearest < search.spacing);
      CHECK((best.T_map_body.translation() - truth.translation()).norm() < 0.05);
      for (std::size_t i = 0; i < found.size(); ++i)
        for (std::size_t j = 0; j < i; ++j)
          CHECK((found[i].translation() - found[j].translation()).norm() > 1.49 * search.spacing);
    });
  }

  TEST_CASE("reaches as far as 40 m/s take a body, within what odometry believes") {
    CHECK(chainslam::detail::TranslationSearch::after(0.1).reach > 4);
    CHECK(chainslam::detail::TranslationSearch::after(0.1).reach < 5);
    CHECK(chainslam::detail::TranslationSearch::after(2).reach == 7);
  }
}
