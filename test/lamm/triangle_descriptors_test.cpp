#include "triangle_descriptors.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <set>
#include <vector>

#include "lamm/keypoint_places.hpp"
#include "support/property.hpp"

namespace chainslam {
namespace {

using CornerSet = std::array<std::uint16_t, 3>;

CornerSet sorted_corners(CornerSet corners) {
  std::ranges::sort(corners);
  return corners;
}

/// The corners of all triangles, in an order of their own.
std::set<CornerSet> corners_of(const std::vector<Triangle>& triangles) {
  std::set<CornerSet> corners;
  for (const Triangle& triangle : triangles) corners.insert(sorted_corners(triangle.corners));
  return corners;
}

float distance(const std::vector<BinaryKeypoint>& keypoints, std::uint16_t i, std::uint16_t j) {
  return (keypoints[i].position - keypoints[j].position).norm();
}

}  // namespace

TEST_SUITE("lamm/triangle_descriptors") {
  TEST_CASE("triangles are the same for any motion and any order of the keypoints") {
    test::for_all(100, [](Rng& rng, int size) {
      const std::vector<BinaryKeypoint> keypoints = test::random_keypoints(rng, 5 + size);
      const SE3d T = test::random_motion(rng, 100);
      const std::vector<std::size_t> order = test::random_order(keypoints.size(), rng);
      std::vector<BinaryKeypoint> moved;
      for (const std::size_t i : order)
        moved.push_back({.position = (T * keypoints[i].position.cast<double>().eval()).cast<float>(),
                         .occupancy = keypoints[i].occupancy});
      const std::vector<Triangle> here = triangles_of(keypoints), there = triangles_of(moved);
      REQUIRE(here.size() == there.size());
      std::set<std::array<std::size_t, 3>> corners, corners_there;
      for (const Triangle& t : here) corners.insert({t.corners[0], t.corners[1], t.corners[2]});
      for (const Triangle& t : there)
        corners_there.insert({order[t.corners[0]], order[t.corners[1]], order[t.corners[2]]});
      CHECK(corners == corners_there);
    });
  }

  TEST_CASE("sides are in order, as long as between the corners that the triangle names, and within the bounds") {
    test::for_all(50, [](Rng& rng, int size) {
      const std::vector<BinaryKeypoint> keypoints = test::random_keypoints(rng, 5 + size);
      const TriangleOptions options;
      for (const Triangle& triangle : triangles_of(keypoints, options)) {
        const auto& [a, b, c] = triangle.corners;
        CHECK(triangle.sides[0] == distance(keypoints, a, b));
        CHECK(triangle.sides[1] == distance(keypoints, a, c));
        CHECK(triangle.sides[2] == distance(keypoints, b, c));
        CHECK(triangle.sides[0] <= triangle.sides[1]);
        CHECK(triangle.sides[1] <= triangle.sides[2]);
        CHECK(triangle.sides[0] >= options.min_side);
        CHECK(triangle.sides[2] <= options.max_side);
        CHECK(triangle.sides[0] + triangle.sides[1] - triangle.sides[2] >= options.min_excess - 1e-4);
      }
    });
  }

  TEST_CASE("the sets of corners are those of brute force, each once") {
    test::for_all(30, [](Rng& rng, int size) {
      const std::vector<BinaryKeypoint> keypoints = test::random_keypoints(rng, 3 + size);
      const TriangleOptions options{.nearest = 6, .min_side = 0, .max_side = 1e3, .min_excess = -1e3};
      std::set<CornerSet> expected;
      for (std::uint16_t i = 0; i < keypoints.size(); ++i) {
        std::vector<std::uint16_t> others;
        for (std::uint16_t j = 0; j < keypoints.size(); ++j) others.push_back(j);
        std::ranges::sort(others, {}, [&](std::uint16_t j) { return distance(keypoints, i, j); });
        others.resize(std::min<std::size_t>(others.size(), 6));  // itself the first
        for (std::size_t m = 1; m < others.size(); ++m)
          for (std::size_t n = m + 1; n < others.size(); ++n)
            expected.insert(sorted_corners({i, others[m], others[n]}));
      }
      const std::vector<Triangle> triangles = triangles_of(keypoints, options);
      CHECK(triangles.size() == expected.size());
      CHECK(corners_of(triangles) == expected);
    });
  }

  TEST_CASE("flat triangles and those with sides that are too short or too long are left out") {
    const auto count = [](const std::vector<Eigen::Vector3f>& corners) {
      std::vector<BinaryKeypoint> keypoints;
      for (const Eigen::Vector3f& corner : corners) keypoints.push_back({.position = corner});
      return triangles_of(keypoints).size();
    };
    CHECK(count({{0, 0, 0}, {3, 0, 0}, {0, 4, 0}}) == 1);
    CHECK(count({{0, 0, 0}, {3, 0, 0}, {6, 0.5F, 0}}) == 0);    // 0.04 m of excess
    CHECK(count({{0, 0, 0}, {0.9F, 0, 0}, {0, 4, 0}}) == 0);    // 0.9 m
    CHECK(count({{0, 0, 0}, {30.1F, 0, 0}, {0, 10, 0}}) == 0);  // 31.7 m
    CHECK(count({{0, 0, 0}, {28, 0, 0}, {0, 10, 0}}) == 1);     // 29.7 m
    CHECK(count({{0, 0, 0}, {3, 0, 0}}) == 0);
    CHECK(count({}) == 0);
  }

  TEST_CASE("more keypoints than can be numbered are refused") {
    CHECK_THROWS_AS(static_cast<void>(triangles_of(std::vector<BinaryKeypoint>(65'536))), std::invalid_argument);
  }
}

}  // namespace chainslam
