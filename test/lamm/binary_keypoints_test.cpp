#include "binary_keypoints.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "lamm/keypoint_places.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {

/// A pole: where it stands, from and to which height there are points.
struct Pole {
  double x, y, bottom, top;
};

void add_pole(const Pole& pole, PointCloud<float>& cloud) {
  for (double height = pole.bottom + 0.025; height < pole.top; height += 0.05)
    cloud.positions.push_back(Eigen::Vector3d(pole.x, pole.y, height).cast<float>());
}

PointCloud<float> ground_with(const std::vector<Pole>& poles) {
  PointCloud<float> cloud;
  for (int x = -20; x <= 20; ++x)
    for (int y = -20; y <= 20; ++y) cloud.positions.emplace_back(static_cast<float>(x), static_cast<float>(y), 0.02F);
  for (const Pole& pole : poles) add_pole(pole, cloud);
  return cloud;
}

/// In the middles of cells of blocks apart, in the grid that the plane z = 0 has.
std::vector<Pole> scattered_poles(Rng& rng, int count) {
  std::vector<Pole> poles;
  while (static_cast<int>(poles.size()) < count) {
    const Pole pole{2.5 * rng.uniform_index(16) - 18.75, 2.5 * rng.uniform_index(16) - 18.75, 0.3,
                    0.1 * (20 + rng.uniform_index(25))};
    const bool is_free = std::ranges::none_of(
        poles, [&](const Pole& other) { return std::hypot(other.x - pole.x, other.y - pole.y) < 2; });
    if (is_free) poles.push_back(pole);
  }
  return poles;
}

}  // namespace

TEST_SUITE("lamm/binary_keypoints") {
  TEST_CASE("poles are found where they stand, with the heights at which they are") {
    test::for_all(30, [](Rng& rng, int /*size*/) {
      const std::vector<Pole> poles = scattered_poles(rng, 12);
      const std::vector<BinaryKeypoint> found = binary_keypoints(ground_with(poles), SurfacePlane{});
      REQUIRE(found.size() == poles.size());
      for (const Pole& pole : poles) {
        const auto keypoint = std::ranges::find_if(found, [&](const BinaryKeypoint& one) {
          return std::hypot(one.position.x() - pole.x, one.position.y() - pole.y) < 0.15;
        });
        REQUIRE(keypoint != found.end());
        CHECK(keypoint->position.z() == doctest::Approx(0));
        CHECK((keypoint->occupancy >> 3) == (std::uint64_t{1} << (std::lround(10 * pole.top) - 3)) - 1);
        CHECK((keypoint->occupancy & 6) == 0);
      }
    });
  }

  TEST_CASE("the order of the points makes no difference, and the highest come first") {
    test::for_all(30, [](Rng& rng, int /*size*/) {
      const PointCloud<float> cloud = ground_with(scattered_poles(rng, 20));
      PointCloud<float> shuffled;
      for (const std::size_t i : test::random_order(cloud.size(), rng))
        shuffled.positions.push_back(cloud.positions[i]);
      const auto here = binary_keypoints(cloud, SurfacePlane{}), there = binary_keypoints(shuffled, SurfacePlane{});
      REQUIRE(here.size() == there.size());
      for (std::size_t i = 0; i < here.size(); ++i) {
        CHECK(here[i].occupancy == there[i].occupancy);
        CHECK((here[i].position - there[i].position).norm() < 1e-5F);
        if (i > 0) CHECK(here[i].occupied() <= here[i - 1].occupied());
      }
    });
  }

  TEST_CASE("poles stand out above any plane, from either side") {
    test::for_all(30, [](Rng& rng, int /*size*/) {
      const std::vector<Pole> poles = scattered_poles(rng, 10);
      const PointCloud<float> cloud = ground_with(poles);
      const SE3d T = test::random_motion(rng, 50);
      PointCloud<float> moved;
      for (const Eigen::Vector3f& p : cloud.positions)
        moved.positions.push_back((T * p.cast<double>().eval()).cast<float>());
      SurfacePlane plane;
      plane.center = T.translation();
      plane.normal = (rng.uniform() < 0.5 ? 1.0 : -1.0) * (T.rotation() * Eigen::Vector3d::UnitZ().eval());
      // Where the grid lies decides whether a pole on the rim of two cells is cut; most are not.
      const std::vector<BinaryKeypoint> found = binary_keypoints(moved, plane);
      Index near = 0;
      for (const BinaryKeypoint& keypoint : found) {
        const Eigen::Vector3d p = T.inverse() * keypoint.position.cast<double>().eval();
        CHECK(std::abs(p.z()) < 1e-3);
        near += std::ranges::any_of(poles,
                                    [&](const Pole& pole) { return std::hypot(p.x() - pole.x, p.y() - pole.y) < 0.3; });
      }
      CHECK(near == to_index(found.size()));
      CHECK(near >= 7);
    });
  }

  TEST_CASE("along a wall there are none") {
    std::vector<Pole> wall;
    for (double y = -15; y <= 15; y += 0.1) wall.push_back({4.25, y, 0.3, 3.0});
    for (const BinaryKeypoint& keypoint : binary_keypoints(ground_with(wall), SurfacePlane{}))
      CHECK(std::abs(keypoint.position.y()) > 14.4F);  // its ends, if any
  }

  TEST_CASE("of two that are near each other the higher stays, of equals none") {
    const auto count = [](double second_top, double distance) {
      const BinaryKeypointOptions options{.block = 1, .suppression_radius = 2.0};
      return binary_keypoints(ground_with({{0.25, 0.25, 0.3, 2.0}, {0.25 + distance, 0.25, 0.3, second_top}}),
                              SurfacePlane{}, options)
          .size();
    };
    CHECK(count(2.6, 1.5) == 1);
    CHECK(count(2.0, 1.5) == 0);
    CHECK(count(2.0, 3.0) == 2);
  }

  TEST_CASE("low ones are left out, and of many the highest are kept") {
    CHECK(binary_keypoints(ground_with({{0.25, 0.25, 0.3, 1.1}}), SurfacePlane{}).empty());  // 8 bins and the ground's
    CHECK(binary_keypoints(ground_with({{0.25, 0.25, 0.3, 1.4}}), SurfacePlane{}).size() == 1);
    Rng rng(3);
    const PointCloud<float> cloud = ground_with(scattered_poles(rng, 20));
    const auto all = binary_keypoints(cloud, SurfacePlane{});
    const auto some = binary_keypoints(cloud, SurfacePlane{}, {.max_count = 7});
    REQUIRE(some.size() == 7);
    for (std::size_t i = 0; i < 7; ++i) CHECK(some[i].occupancy == all[i].occupancy);
  }

  TEST_CASE("similarity is Dice's coefficient") {
    const auto with = [](std::uint64_t bits) {
      return BinaryKeypoint{.position = Eigen::Vector3f::Zero(), .occupancy = bits};
    };
    CHECK(similarity(with(0b1111), with(0b1111)) == 1.0);
    CHECK(similarity(with(0b1100), with(0b0011)) == 0.0);
    CHECK(similarity(with(0b1110), with(0b0010)) == doctest::Approx(2.0 * 1 / 4));
    CHECK(similarity(with(0), with(0)) == 0.0);
  }

  TEST_CASE("more bins than bits are refused, and points that are not finite are skipped") {
    CHECK_THROWS_AS(static_cast<void>(binary_keypoints({}, SurfacePlane{}, {.bin_height = 0.05})),
                    std::invalid_argument);
    PointCloud<float> cloud = ground_with({{0.25, 0.25, 0.3, 2.0}});
    cloud.positions.emplace_back(std::nanf(""), 0.F, 0.F);
    cloud.positions.emplace_back(0.F, INFINITY, 1.F);
    CHECK(binary_keypoints(cloud, SurfacePlane{}).size() == 1);
  }
}

}  // namespace chainslam
