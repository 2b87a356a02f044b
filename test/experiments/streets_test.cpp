#include <doctest/doctest.h>

#include <cmath>
#include <numbers>
#include <vector>

#include "chainslam/core/random.hpp"
#include "streets/cloud_errors.hpp"
#include "streets/streets.hpp"

namespace chainslam::experiments {
namespace {

/// From point to point in steps of 3 m.
Trajectory drive_along(const std::vector<Eigen::Vector3d>& corners) {
  Trajectory drive;
  for (std::size_t k = 0; k + 1 < corners.size(); ++k) {
    const Eigen::Vector3d way = corners[k + 1] - corners[k];
    for (double at = 0; at < way.norm(); at += 3) {
      drive.times.push_back(Timestamp::from_seconds(static_cast<double>(drive.times.size())));
      drive.poses.emplace_back(SO3d(), corners[k] + at * way.normalized());
    }
  }
  return drive;
}

/// Walls, a floor and boxes of a street that looks different everywhere.
PointCloud<float> street_scene(double noise, std::uint64_t seed) {
  PointCloud<float> cloud;
  Rng shape(1), rng(seed);
  const auto add = [&](double x, double y, double z) {
    cloud.positions.emplace_back(
        Eigen::Vector3d(x + noise * rng.normal(), y + noise * rng.normal(), z + noise * rng.normal()).cast<float>());
  };
  for (int house = 0; house < 12; ++house) {
    const double x0 = 5.0 * house, left = 8 + shape.uniform(0, 4), right = -8 - shape.uniform(0, 4);
    const double height = shape.uniform(3, 10);
    for (double x = x0; x < x0 + 4; x += 0.3)
      for (double z = 0; z < height; z += 0.3) add(x, left, z), add(x, right, 0.7 * z);
    for (double y = right; y < left; y += 0.4)
      for (double x = x0; x < x0 + 5; x += 0.4) add(x, y, 0);
  }
  return cloud;
}

}  // namespace

TEST_SUITE("experiments/streets") {
  TEST_CASE("streets that are driven most come first, straight and apart") {
    const std::vector<Trajectory> drives{drive_along({{0, 0, 0}, {200, 0, 0}, {200, 100, 0}}),
                                         drive_along({{210, 0, 0}, {120, 2, 0}, {120, 90, 0}}),
                                         drive_along({{0, 300, 0}, {70, 300, 0}})};
    const std::vector<Street> streets = chosen_streets(drives, {});
    REQUIRE(streets.size() == 4);
    CHECK(streets[0].sessions == 2);
    CHECK(std::abs(streets[0].begin.y()) < 1);  // the part of y = 0 that both have
    CHECK(std::max(streets[0].begin.x(), streets[0].end.x()) > 150);
    for (const Street& street : streets) {
      CHECK(length_of(street) >= 50);
      CHECK(length_of(street) < 53.1);
      for (const Street& other : streets)
        if (&other != &street)
          CHECK((0.5 * (street.begin + street.end) - 0.5 * (other.begin + other.end)).norm() >= 50);
    }
  }

  TEST_CASE("no street goes around a corner, and short or empty drives have none") {
    std::vector<Eigen::Vector3d> circle;
    for (int i = 0; i <= 60; ++i)
      circle.emplace_back(40 * std::sin(i * std::numbers::pi / 30), 40 * std::cos(i * std::numbers::pi / 30), 0);
    CHECK(chosen_streets(std::vector{drive_along(circle)}, {}).empty());
    CHECK(chosen_streets(std::vector{drive_along({{0, 0, 0}, {40, 0, 0}}), Trajectory{}}, {}).empty());
  }

  TEST_CASE("along and beside a street") {
    const Street street{.begin = {10, 0, 0}, .end = {10, 50, 5}, .sessions = 1, .driven = 1};
    CHECK(on_street(street, {13, 20, 99}).along == doctest::Approx(20));
    CHECK(on_street(street, {13, 20, 99}).beside == doctest::Approx(3));
    CHECK(is_on(street, {13, 20, 0}, 3.5));
    CHECK_FALSE(is_on(street, {13, 20, 0}, 2.5));
    CHECK_FALSE(is_on(street, {10, -1, 0}, 3));
    CHECK_FALSE(is_on(street, {10, 51, 0}, 3));
  }

  TEST_CASE("distances to the nearest points are those of a shift that is known") {
    PointCloud<float> plane;
    for (int i = 0; i < 40; ++i)
      for (int k = 0; k < 40; ++k)
        plane.positions.emplace_back(0.5F * static_cast<float>(i), 0.5F * static_cast<float>(k), 0.F);
    const KdTree<float> tree(plane);
    CHECK(rms_distance(plane, SE3d(), tree) == 0);
    CHECK(rms_distance(plane, SE3d(SO3d(), {0, 0, 0.2}), tree) == doctest::Approx(0.2));
  }

  TEST_CASE(
      "a cloud that is moved is brought back, one that is bent is not quite, and thickness is that of its walls") {
    const PointCloud<float> reference = street_scene(0.02, 1);
    const SE3d T(SO3d::exp({0.01, -0.02, 0.4}), {12, -5, 1});
    const CloudErrors moved = cloud_errors(transformed(street_scene(0.02, 2), T), reference, T.inverse());
    CHECK(moved.as_aligned < 0.1);
    CHECK(moved.after_ransac < 1.0);
    CHECK(moved.after_icp < 0.12);
    CHECK(moved.after_icp <= moved.after_ransac);
    CHECK(moved.thickness < 0.15);

    // Half of the scans half a metre aside and turned: walls are there twice.
    PointCloud<float> twice = street_scene(0.02, 2);
    const PointCloud<float> again = transformed(street_scene(0.02, 3), SE3d(SO3d::exp({0, 0, 0.01}), {0, 0.4, 0}));
    twice.positions.insert(twice.positions.end(), again.positions.begin(), again.positions.end());
    const CloudErrors doubled = cloud_errors(twice, reference, SE3d());
    CHECK(doubled.as_aligned > 0.15);
    CHECK(doubled.after_icp > 1.5 * moved.after_icp);
    CHECK(doubled.thickness > 1.2 * moved.thickness);
  }

  TEST_CASE("too few points give no figures") {
    PointCloud<float> few;
    few.positions.assign(20, Eigen::Vector3f::Zero());
    const CloudErrors errors = cloud_errors(few, street_scene(0.02, 1), SE3d());
    CHECK(std::isnan(errors.as_aligned));
    CHECK(std::isnan(errors.after_icp));
    CHECK(errors.points == 20);
  }
}

}  // namespace chainslam::experiments
