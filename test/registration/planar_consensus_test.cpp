#include "chainslam/registration/consistency_graph.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <vector>

#include "support/property.hpp"

namespace chainslam {
namespace {

using test::for_all;

std::vector<PlanarMatch> planar_matches(Rng& rng, const SE2d& motion, int right, int wrong, double noise) {
  std::vector<PlanarMatch> matches;
  const auto anywhere = [&] { return Eigen::Vector2d(rng.uniform(-60, 60), rng.uniform(-60, 60)); };
  for (int i = 0; i < right; ++i) {
    const Eigen::Vector2d p = anywhere();
    matches.push_back({p, motion * p + Eigen::Vector2d(rng.normal(0, noise), rng.normal(0, noise)),
                       motion.rotation().angle() + rng.normal(0, 2 * noise / 5)});
  }
  for (int i = 0; i < wrong; ++i) matches.push_back({anywhere(), anywhere(), rng.uniform(-4, 4)});
  return matches;
}

/// Each match tried as the seed, by its definition.
PlanarConsensus tried_one_by_one(const std::vector<PlanarMatch>& matches, const PlanarConsensusOptions& options) {
  const auto agreeing = [&](const SE2d& T, double distance, double per_metre, const Eigen::Vector2d& center) {
    detail::PlanarSums sums;
    for (const PlanarMatch& match : matches) {
      const double angle = std::remainder(match.turned - T.rotation().angle(), 2 * std::numbers::pi);
      const double allowed = distance + per_metre * (match.source - center).norm();
      if (std::abs(angle) <= options.max_angle && (T * match.source - match.target).norm() <= allowed) sums.add(match);
    }
    return sums;
  };
  PlanarConsensus best;
  for (const PlanarMatch& seed : matches) {
    const auto R = SO2<double>::from_angle(seed.turned);
    SE2d T(R, seed.target - R * seed.source);
    detail::PlanarSums sums = agreeing(T, 2 * options.max_distance, options.max_per_metre, seed.source);
    for (int k = 0; k < 3 && sums.count >= 3; ++k) {
      T = sums.motion();
      sums = agreeing(T, options.max_distance, 0, seed.source);
    }
    if (sums.count >= 3 && sums.count > best.inliers) best = {sums.motion(), sums.count};
  }
  return best;
}

}  // namespace

TEST_SUITE("registration/planar_consensus") {
  TEST_CASE("without noise the motion is exact, whatever the other matches say") {
    for_all(50, [](Rng& rng, int) {
      const SE2d motion(SO2<double>::from_angle(rng.uniform(-3.1, 3.1)), {rng.uniform(-50, 50), rng.uniform(-50, 50)});
      const auto matches = planar_matches(rng, motion, 8, 30, 0);
      const PlanarConsensus found = planar_consensus(matches);
      CHECK(found.inliers >= 8);
      const SE2d off = motion.inverse() * found.T_target_source;
      CHECK(off.translation().norm() < (found.inliers == 8 ? 1e-9 : 1.0));  // another may lie within 1.5 m by chance
      CHECK(std::abs(off.rotation().angle()) < (found.inliers == 8 ? 1e-9 : 0.05));
    });
  }

  TEST_CASE("with noise it is as near as the inliers' number allows") {
    for_all(50, [](Rng& rng, int) {
      const SE2d motion(SO2<double>::from_angle(rng.uniform(-3.1, 3.1)), {rng.uniform(-50, 50), rng.uniform(-50, 50)});
      const PlanarConsensus found = planar_consensus(planar_matches(rng, motion, 20, 60, 0.3));
      CHECK(found.inliers >= 16);
      const SE2d off = motion.inverse() * found.T_target_source;
      CHECK(off.translation().norm() < 0.5);  // 0.3 / sqrt(20) is 0.07; chance inliers add to it
      CHECK(std::abs(off.rotation().angle()) < 0.02);
    });
  }

  TEST_CASE("directions that contradict the motion make no inliers") {
    Rng rng(1);
    auto matches = planar_matches(rng, SE2d(), 10, 0, 0);
    CHECK(planar_consensus(matches).inliers == 10);
    for (PlanarMatch& match : matches) match.turned += 0.4;
    CHECK(planar_consensus(matches).inliers < 10);
    for (PlanarMatch& match : matches) match.turned -= 0.1;  // within 0.35 rad, but no seed is near enough
    CHECK(planar_consensus(matches, {.max_per_metre = 0.4}).inliers == 10);
  }

  TEST_CASE("what is skipped changes nothing: the result is bit-identical to trying each match") {
    for_all(50, [](Rng& rng, int size) {
      const SE2d motion(SO2<double>::from_angle(rng.uniform(-3.1, 3.1)), {rng.uniform(-50, 50), rng.uniform(-50, 50)});
      auto matches = planar_matches(rng, motion, size, 3 * size, 0.3);
      for (PlanarMatch& match : matches) match.turned += 2 * std::numbers::pi * (rng.uniform_index(3) - 1);
      for (const double max_angle : {0.01, 0.35, 3.2, 1e300}) {
        const PlanarConsensusOptions options{.max_angle = max_angle};
        const PlanarConsensus found = planar_consensus(matches, options), expected = tried_one_by_one(matches, options);
        CHECK(found.inliers == expected.inliers);
        CHECK(found.T_target_source.translation() == expected.T_target_source.translation());
        CHECK(found.T_target_source.rotation().angle() == expected.T_target_source.rotation().angle());
      }
    });
  }

  TEST_CASE("a direction that is no number agrees with nothing") {
    Rng rng(3);
    auto matches = planar_matches(rng, SE2d(), 10, 0, 0);
    matches[0].turned = std::numeric_limits<double>::quiet_NaN();
    matches[1].turned = std::numeric_limits<double>::infinity();
    CHECK(planar_consensus(matches).inliers == 8);
  }

  TEST_CASE("fewer than three that agree are nothing, options that make no sense are refused") {
    Rng rng(2);
    CHECK(planar_consensus({}).inliers == 0);
    const PlanarConsensus two = planar_consensus(planar_matches(rng, SE2d(), 2, 0, 0));
    CHECK(two.inliers == 0);
    CHECK(two.T_target_source.translation().norm() == 0);
    CHECK_THROWS_AS(static_cast<void>(planar_consensus({}, {.max_distance = 0})), std::invalid_argument);
    CHECK_THROWS_AS(static_cast<void>(planar_consensus({}, {.max_angle = 0})), std::invalid_argument);
  }
}

}  // namespace chainslam
