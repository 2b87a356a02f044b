#include "chainslam/slam/place_index.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <numbers>
#include <vector>

#include "support/property.hpp"

namespace chainslam {
namespace {

using test::for_all;

/// Keypoints all over a square of 120 m, as different as random bits.
std::vector<ImageKeypoint> made_up_place(Rng& rng, int count) {
  std::vector<ImageKeypoint> keypoints(static_cast<std::size_t>(count));
  for (ImageKeypoint& keypoint : keypoints) {
    keypoint.position = Eigen::Vector2d(rng.uniform(-60, 60), rng.uniform(-60, 60)).cast<float>();
    keypoint.angle = static_cast<float>(rng.uniform(-3, 3));
    keypoint.descriptor = {rng.bits(), rng.bits(), rng.bits(), rng.bits()};
  }
  return keypoints;
}

/// The same keypoints in another frame; each found with a probability, 0.3 m and 0.1 rad off, with `bits` bits changed.
std::vector<ImageKeypoint> seen_again(const std::vector<ImageKeypoint>& place, const SE2d& T_query_place, double share,
                                      Index bits, Rng& rng) {
  std::vector<ImageKeypoint> seen;
  for (ImageKeypoint keypoint : place) {
    if (rng.uniform() > share) continue;
    const Eigen::Vector2d noise(rng.normal(0, 0.3), rng.normal(0, 0.3));
    keypoint.position = (T_query_place * keypoint.position.cast<double>().eval() + noise).cast<float>();
    keypoint.angle += static_cast<float>(T_query_place.rotation().angle() + rng.normal(0, 0.1));
    for (Index k = 0; k < bits; ++k) {
      const Index bit = rng.uniform_index(256);
      keypoint.descriptor[static_cast<std::size_t>(bit / 64)] ^= std::uint64_t{1} << (bit % 64);
    }
    seen.push_back(keypoint);
  }
  return seen;
}

SE2d any_motion(Rng& rng) {
  return {SO2<double>::from_angle(rng.uniform(-3.1, 3.1)), {rng.uniform(-40, 40), rng.uniform(-40, 40)}};
}

}  // namespace

TEST_SUITE("slam/place_index") {
  TEST_CASE("a place is found among others from any heading, though two thirds of its keypoints are lost") {
    for_all(20, [](Rng& rng, int) {
      PlaceIndex index;
      std::vector<std::vector<ImageKeypoint>> places;
      for (Index i = 0; i < 60; ++i) {
        places.push_back(made_up_place(rng, 120));
        CHECK(index.add(places.back()) == i);
      }
      const Index here = rng.uniform_index(60);
      const SE2d T_query_place = any_motion(rng);
      auto query = seen_again(places[static_cast<std::size_t>(here)], T_query_place, 0.33, 40, rng);
      const auto clutter = made_up_place(rng, 80);
      query.insert(query.end(), clutter.begin(), clutter.end());
      const auto found = index.find(query);
      REQUIRE(!found.empty());
      CHECK(found.front().place == here);
      CHECK(found.front().inliers >= 15);
      const SE2d off = found.front().T_place_query * T_query_place;
      CHECK(off.translation().norm() < 0.6);
      CHECK(std::abs(off.rotation().angle()) < 0.02);
      for (std::size_t i = 1; i < found.size(); ++i) CHECK(found[i].inliers <= found[i - 1].inliers);
    });
  }

  TEST_CASE("a place that is not in the index is not found, nor one that is not wanted") {
    for_all(20, [](Rng& rng, int) {
      PlaceIndex index;
      std::vector<ImageKeypoint> place;
      for (int i = 0; i < 30; ++i) index.add(place = made_up_place(rng, 120));
      CHECK(index.find(made_up_place(rng, 120)).empty());
      CHECK(index.find(place).size() == 1);
      CHECK(index.find(place, [](Index one) { return one != 29; }).empty());
    });
  }

  TEST_CASE("of places that look the same, the first comes first; the shortlist bounds how many come") {
    Rng rng(3);
    const auto place = made_up_place(rng, 60);
    PlaceIndex index({.shortlist = 4});
    for (int i = 0; i < 6; ++i) index.add(place);
    const auto found = index.find(place);
    REQUIRE(found.size() == 4);
    for (Index i = 0; i < 4; ++i) CHECK(found[static_cast<std::size_t>(i)].place == i);
  }

  TEST_CASE("nothing is found in an empty index or without keypoints") {
    Rng rng(4);
    PlaceIndex index;
    CHECK(index.find(made_up_place(rng, 10)).empty());
    CHECK(index.add({}) == 0);
    CHECK(index.find({}).empty());
    CHECK(index.compare(made_up_place(rng, 10), 0).inliers == 0);
    CHECK_THROWS_AS(PlaceIndex({.max_distance = -1}), std::invalid_argument);
    CHECK_THROWS_AS(PlaceIndex({.shortlist = 0}), std::invalid_argument);
    CHECK_THROWS_AS(PlaceIndex({.min_inliers = 2}), std::invalid_argument);
  }
}

}  // namespace chainslam
