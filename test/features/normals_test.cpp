#include "chainslam/features/normals.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/search/brute_force.hpp"
#include "chainslam/search/voxel_map.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {

PointCloud<float> sphere(Rng& rng, int count, double radius) {
  PointCloud<float> cloud;
  for (int i = 0; i < count; ++i)
    cloud.positions.push_back(
        (radius * Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).normalized()).cast<float>());
  return cloud;
}

TEST_SUITE("features/normals") {
  TEST_CASE("normals of a sphere point at a viewpoint in its middle") {
    Rng rng(1);
    PointCloud<float> cloud = sphere(rng, 5000, 5.0);
    const NormalEstimates estimates = estimate_normals(cloud, {.neighbors = 12});
    CHECK(estimates.without_normal == 0);
    double worst = 1;
    for (std::size_t i = 0; i < cloud.size(); ++i)
      worst = std::min(worst, -static_cast<double>(cloud.normals[i].dot(cloud.positions[i].normalized())));
    // Twelve neighbours of 5000 reach 0.5 m: about 3 deg of tilt at the worst, by their uneven spread.
    CHECK(worst > std::cos(0.1));
    for (const float curvature : estimates.curvature) CHECK(curvature < 0.02f);
  }

  TEST_CASE("noise of a plane tilts its normals by what the fit of n points predicts") {
    // 20 points over a disc of radius r, sigma across: tilt about sigma / (r / 2) / sqrt(20).
    Rng rng(2);
    PointCloud<float> cloud;
    for (int i = 0; i < 4000; ++i)
      cloud.positions.push_back(
          Eigen::Vector3d(rng.uniform(-5, 5), rng.uniform(-5, 5), 2 + 0.005 * rng.normal()).cast<float>());
    const NormalEstimates estimates = estimate_normals(cloud, {.neighbors = 20}, {0, 0, 100});
    CHECK(estimates.without_normal == 0);
    const double disc = std::sqrt(20 * 100 / (4000 * std::acos(-1.0)));
    const double expected = 0.005 / (disc / 2) / std::sqrt(20.0);
    double sum = 0;
    for (const Eigen::Vector3f& normal : cloud.normals) {
      CHECK(normal.norm() == doctest::Approx(1.0));
      CHECK(normal[2] > 0);
      sum += static_cast<double>(normal.head<2>().squaredNorm()) / 2;  // mean square of one component of the tilt
    }
    const double rms = std::sqrt(sum / 4000);
    CHECK(rms > 0.7 * expected);
    CHECK(rms < 1.5 * expected);
  }

  TEST_CASE("the viewpoint decides the sign") {
    PointCloud<float> cloud;
    for (int x = 0; x < 5; ++x)
      for (int y = 0; y < 5; ++y) cloud.positions.emplace_back(static_cast<float>(x), static_cast<float>(y), 0.0f);
    (void)estimate_normals(cloud, {.neighbors = 9}, {0, 0, 5});
    CHECK(cloud.normals[7].isApprox(Eigen::Vector3f(0, 0, 1)));
    (void)estimate_normals(cloud, {.neighbors = 9}, {0, 0, -5});
    CHECK(cloud.normals[7].isApprox(Eigen::Vector3f(0, 0, -1)));
  }

  TEST_CASE("all within a radius equals many nearest within that radius, over any search") {
    test::for_all(20, [](Rng& rng, int size) {
      PointCloud<float> by_radius = sphere(rng, 10 * size + 50, 3.0), by_both = by_radius, by_map = by_radius;
      const NormalEstimates a = estimate_normals(by_radius, BruteForce<>(by_radius), {.neighbors = 0, .radius = 1});
      const NormalEstimates b = estimate_normals(by_both, {.neighbors = 2000, .radius = 1});
      const VoxelMap<> map(by_map, {.voxel_size = 1, .max_points_per_voxel = 5000, .min_spacing = 0});
      const NormalEstimates c = estimate_normals(by_map, map, {.neighbors = 0, .radius = 1});
      CHECK(a.without_normal == b.without_normal);
      CHECK(a.without_normal == c.without_normal);
      for (std::size_t i = 0; i < by_both.size(); ++i) {
        CHECK((by_radius.normals[i] - by_both.normals[i]).norm() < 1e-4f);  // sums in another order
        CHECK((by_radius.normals[i] - by_map.normals[i]).norm() < 1e-4f);
      }
    });
  }

  TEST_CASE("isolated points, lines, duplicates and NaN get the zero vector and are counted") {
    PointCloud<float> cloud;
    const float nan = std::numeric_limits<float>::quiet_NaN();
    for (int i = 0; i < 8; ++i) cloud.positions.emplace_back(static_cast<float>(i) * 0.1f, 0.0f, 0.0f);  // a line
    for (int i = 0; i < 8; ++i) cloud.positions.emplace_back(50.0f, 0.0f, 0.0f);                         // one place
    cloud.positions.emplace_back(0.0f, 90.0f, 0.0f);                                                     // alone
    cloud.positions.emplace_back(nan, 0.0f, 0.0f);
    const NormalEstimates estimates = estimate_normals(cloud, {.neighbors = 6, .radius = 2});
    CHECK(estimates.without_normal == 18);
    for (const Eigen::Vector3f& normal : cloud.normals) CHECK(normal == Eigen::Vector3f(0, 0, 0));
    PointCloud<float> none;
    CHECK(estimate_normals(none).without_normal == 0);
    CHECK(none.normals.empty());
  }

  TEST_CASE("any number of threads gives the same bits") {
    Rng rng(4);
    PointCloud<float> serial = sphere(rng, 3000, 4.0);
    const NormalEstimates expected = estimate_normals(serial, {.neighbors = 10});
    for (const Index threads : {1, 2, 5}) {
      PointCloud<float> cloud = serial;
      const ThreadPool pool(threads);
      const NormalEstimates estimates = estimate_normals(cloud, {.neighbors = 10}, {0, 0, 0}, pool);
      CHECK(cloud.normals == serial.normals);
      CHECK(estimates.planarity == expected.planarity);
      CHECK(estimates.curvature == expected.curvature);
    }
  }

  TEST_CASE("options that name no neighbourhood are refused") {
    PointCloud<float> cloud;
    CHECK_THROWS_AS(estimate_normals(cloud, {.neighbors = 0}), std::invalid_argument);
    CHECK_THROWS_AS(estimate_normals(cloud, {.neighbors = -1}), std::invalid_argument);
    CHECK_THROWS_AS(estimate_normals(cloud, {.radius = 0}), std::invalid_argument);
  }
}

}  // namespace
}  // namespace chainslam
