#include "chainslam/registration/alignment_checks.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include "chainslam/core/random.hpp"
#include "chainslam/features/normals.hpp"
#include "chainslam/search/indexed_cloud.hpp"

namespace chainslam {
namespace {

/// A floor of 20 m by 20 m about the origin, `spacing` metres from point to point, each `noise` metres off at random.
PointCloud<float> floor_of(double spacing, double noise, std::uint64_t seed) {
  Rng rng(seed);
  PointCloud<float> cloud;
  for (double x = -10; x < 10; x += spacing)
    for (double y = -10; y < 10; y += spacing) {
      const double jitter_x = rng.uniform(-0.3, 0.3) * spacing, jitter_y = rng.uniform(-0.3, 0.3) * spacing;
      cloud.positions.emplace_back(static_cast<float>(x + jitter_x), static_cast<float>(y + jitter_y),
                                   static_cast<float>(noise * rng.normal()));
    }
  return cloud;
}

SE3d moved(double x, double y, double z) { return SE3d(SO3d(), {x, y, z}); }

IndexedCloud<> level(PointCloud<float> cloud) {
  cloud.normals.assign(cloud.positions.size(), Eigen::Vector3f::UnitZ());
  return IndexedCloud<>(std::move(cloud));
}

}  // namespace

TEST_SUITE("registration/surface_fit") {
  TEST_CASE("points over a plane are as far from it as they are, whatever the spacing of its points") {
    for (const double spacing : {0.1, 0.2, 0.4}) {
      CAPTURE(spacing);
      const IndexedCloud<> floor = level(floor_of(spacing, 0, 1));
      const SurfaceFit fit = surface_fit(floor_of(0.37, 0, 2), floor, moved(0, 0, 0.3));
      CHECK(fit.rmse == doctest::Approx(0.3).epsilon(1e-6));
      CHECK(fit.overlap == 1);
    }
  }

  TEST_CASE("what only one cloud has does not count among the nearest points; a floor that lies elsewhere does") {
    const IndexedCloud<> floor = level(floor_of(0.2, 0, 1));
    PointCloud<float> scan = floor_of(0.37, 0, 2);
    for (std::size_t i = 0; i < scan.size(); i += 10) scan.positions[i].z() = 0.8F;  // something stands there
    CHECK(surface_fit(scan, floor, SE3d()).worst_rmse == doctest::Approx(0.8 * std::sqrt(0.1)).epsilon(0.01));
    const SurfaceFit nearest = surface_fit(scan, floor, SE3d(), {.share = 0.8});
    CHECK(nearest.worst_rmse < 1e-6);
    CHECK(nearest.rmse == doctest::Approx(0.8 * std::sqrt(0.1)).epsilon(0.01));
    CHECK(surface_fit(floor_of(0.37, 0, 2), floor, moved(0, 0, 0.3), {.share = 0.8}).worst_rmse ==
          doctest::Approx(0.3).epsilon(1e-6));
    for (const double share : {0.0, 1.1})
      CHECK_THROWS_AS((void)surface_fit(scan, floor, SE3d(), {.share = share}), std::invalid_argument);
  }

  TEST_CASE("the noise of a floor is that of two points: root of two times one point's") {
    const IndexedCloud<> floor = level(floor_of(0.1, 0.06, 3));
    CHECK(surface_noise(floor) == doctest::Approx(std::sqrt(2.0) * 0.06).epsilon(0.05));
    CHECK(surface_noise(level(floor_of(0.1, 0, 3))) == 0);
  }

  TEST_CASE("a scan with the floor's own noise has a misfit of one, at half the overlap of two") {
    const double noise = 0.08;
    const IndexedCloud<> floor = level(floor_of(0.2, noise, 4));
    const PointCloud<float> scan = floor_of(0.3, noise, 5);
    CHECK(surface_fit(scan, floor, SE3d()).misfit(surface_noise(floor)) == doctest::Approx(1).epsilon(0.05));
    const SurfaceFit beside = surface_fit(scan, floor, moved(10.5, 0, 0));
    CHECK(beside.overlap == doctest::Approx(0.5).epsilon(0.03));
    CHECK(beside.misfit(surface_noise(floor)) == doctest::Approx(2).epsilon(0.08));
  }

  TEST_CASE("what slid along a floor does not fit in that direction, however much floor there is") {
    PointCloud<float> hall = floor_of(0.2, 0.02, 12);
    hall.normals.assign(hall.positions.size(), Eigen::Vector3f::UnitZ());
    for (float y = -1; y < 1; y += 0.2F)
      for (float z = 0.6F; z < 2.6F; z += 0.2F) {
        hall.positions.emplace_back(5, y, z);
        hall.normals.push_back(Eigen::Vector3f::UnitX());
      }
    const PointCloud<float> scan = hall;
    const IndexedCloud<> target(std::move(hall));
    const SurfaceFit there = surface_fit(scan, target, SE3d()), slid = surface_fit(scan, target, moved(0.4, 0, 0));
    CHECK(there.worst_misfit(0.05) < 0.01);
    CHECK(slid.misfit(0.05) < 1.5);
    CHECK(slid.worst_rmse == doctest::Approx(0.4).epsilon(0.02));
    CHECK(slid.worst_misfit(0.05) > 5);
    CHECK(surface_fit(PointCloud<float>{}, target, SE3d()).worst_misfit(0.05) ==
          std::numeric_limits<double>::infinity());
  }

  TEST_CASE("noise below what a laser measures does not make a good fit a bad one") {
    const IndexedCloud<> exact = level(floor_of(0.2, 0, 6));
    const SurfaceFit fit = surface_fit(floor_of(0.3, 0.02, 7), exact, SE3d());
    CHECK(fit.misfit(surface_noise(exact)) == doctest::Approx(0.02 / 0.05).epsilon(0.05));
  }

  TEST_CASE("one point of many tells as much as all of them, to a tenth") {
    const IndexedCloud<> floor = level(floor_of(0.1, 0.05, 8));
    const PointCloud<float> scan = floor_of(0.11, 0.05, 9);
    const SurfaceFit all = surface_fit(scan, floor, SE3d(), {.max_points = 1'000'000});
    const SurfaceFit some = surface_fit(scan, floor, SE3d(), {.max_points = 500});
    CHECK(some.rmse == doctest::Approx(all.rmse).epsilon(0.1));
    CHECK(some.rmse != all.rmse);
  }

  TEST_CASE("without overlap, points or normals nothing fits") {
    const IndexedCloud<> floor = level(floor_of(0.5, 0.01, 10));
    const PointCloud<float> scan = floor_of(0.5, 0.01, 11);
    constexpr double infinite = std::numeric_limits<double>::infinity();
    CHECK(surface_fit(scan, floor, moved(0, 0, 5)).misfit(0.1) == infinite);
    CHECK(surface_fit(PointCloud<float>{}, floor, SE3d()).misfit(0.1) == infinite);
    PointCloud<float> nowhere;
    nowhere.positions.assign(20, Eigen::Vector3f::Constant(std::numeric_limits<float>::quiet_NaN()));
    CHECK(surface_fit(nowhere, floor, SE3d()).misfit(0.1) == infinite);
    PointCloud<float> without = floor_of(0.5, 0.01, 10);
    without.normals.assign(without.positions.size(), Eigen::Vector3f::Zero());
    CHECK(surface_fit(scan, IndexedCloud<>(without), SE3d()).overlap == 0);
    CHECK(surface_noise(IndexedCloud<>(without)) == infinite);
    CHECK_THROWS_AS((void)surface_fit(scan, floor, SE3d(), {.max_points = 0}), std::invalid_argument);
    CHECK_THROWS_AS((void)surface_noise(floor, {.max_distance = 0}), std::invalid_argument);
  }
}

}  // namespace chainslam
