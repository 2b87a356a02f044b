#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "chainslam/core/random.hpp"
#include "chainslam/registration/align.hpp"
#include "chainslam/registration/alignment_checks.hpp"
#include "chainslam/search/indexed_cloud.hpp"
#include "registration/scenes.hpp"

namespace chainslam {
namespace {

constexpr double right_angle = std::numbers::pi / 2;

PointCloud<float> turned(PointCloud<float> cloud, double angle) {
  const Eigen::Matrix3f R = SO3d::exp({0, 0, angle}).matrix().cast<float>();
  for (Eigen::Vector3f& p : cloud.positions) p = R * p;
  for (Eigen::Vector3f& n : cloud.normals) n = R * n;
  return cloud;
}

AlignResult aligned(const PointCloud<float>& source, const IndexedCloud<>& target, const SE3d& guess) {
  return Icp<PointToPlane, Huber>{.max_distance = 2.0}.align(source, target, guess);
}

}  // namespace

TEST_SUITE("registration/weakest_direction") {
  TEST_CASE("the position is known least along a corridor, as little however the scanner is turned in it") {
    Rng rng(1);
    const IndexedCloud<> corridor(test::sample(rng, test::corridor(), 8000, 0.01));
    const PointCloud<float> middle = test::middle_of_corridor(rng, 2000);
    for (const double angle : {0.0, 0.5, 0.5 * right_angle, right_angle}) {
      CAPTURE(angle);
      const AlignResult result = aligned(turned(middle, angle), corridor, SE3d(SO3d::exp({0, 0, -angle}), {0, 0, 0}));
      const WeakestDirection weakest = weakest_direction(result);
      const Eigen::Vector3d along(std::cos(angle), std::sin(angle), 0);
      CHECK(std::abs(weakest.direction.dot(along)) > 0.999);
      CHECK(weakest.localizability <= 0.003);
      CHECK(weakest.localizability <= 1.001 * std::max(result.localizability.head<3>().minCoeff(), 0.003));
    }
  }

  TEST_CASE("where walls stand across each other, a fifth of the points or more determine each direction") {
    Rng rng(2);
    const IndexedCloud<> yard(test::sample(rng, test::yard(), 8000, 0.01));
    const AlignResult result = aligned(test::sample(rng, test::yard(), 2000, 0.01), yard, SE3d());
    CHECK(weakest_direction(result).localizability > 0.1);
    CHECK(weakest_direction(result).localizability <= 1.001 * result.localizability.head<3>().minCoeff());
    CHECK(weakest_direction(AlignResult{}).localizability == 1);
  }
}

TEST_SUITE("registration/is_repeatable") {
  TEST_CASE("from either side a scan comes back to its place in a yard, and stays where it starts in a corridor") {
    Rng rng(3);
    const Icp<PointToPlane, Huber> icp{.max_distance = 2.0, .degeneracy_threshold = 1e-3};
    const IndexedCloud<> yard(test::sample(rng, test::yard(), 8000, 0.01));
    const PointCloud<float> scan = test::sample(rng, test::yard(), 2000, 0.01);
    const AlignResult there = icp.align(scan, yard, SE3d());
    CHECK(is_repeatable(icp, scan, yard, there, 1.0, 0.5));
    const IndexedCloud<> corridor(test::sample(rng, test::corridor(), 8000, 0.01));
    const PointCloud<float> middle = test::middle_of_corridor(rng, 2000);
    const AlignResult somewhere = icp.align(middle, corridor, SE3d());
    REQUIRE(somewhere.inlier_ratio > 0.9);
    CHECK(!is_repeatable(icp, middle, corridor, somewhere, 1.0, 0.5));
    CHECK(is_repeatable(icp, middle, corridor, somewhere, 1.0, 1.5));
    CHECK(!is_repeatable(icp, scan, yard, there, 100.0, 0.5));
  }
}

}  // namespace chainslam
