#include "chainslam/slam/closure_candidates.hpp"

#include <doctest/doctest.h>

#include "slam/street.hpp"
#include "support/property.hpp"

using namespace chainslam;
using namespace chainslam::test;

TEST_SUITE("slam/position_index") {
  TEST_CASE("appended and rebuilt positions are found as a plain search finds them, nearest first") {
    for_all(60, [](Rng& rng, int size) {
      std::vector<SE3d> poses;
      PositionIndex index;
      const auto check = [&] {
        const Eigen::Vector3d center(rng.uniform(0, 20), rng.uniform(0, 20), 0);
        const double radius = rng.uniform(0, 12);
        std::vector<std::pair<double, Index>> expected;
        for (std::size_t i = 0; i < poses.size(); ++i)
          if (const double d = (poses[i].translation() - center).norm(); d <= radius)
            expected.emplace_back(d, static_cast<Index>(i));
        std::ranges::sort(expected);
        const auto found = index.within(center, radius);
        REQUIRE(found.size() == expected.size());
        for (std::size_t i = 0; i < found.size(); ++i) {
          CHECK(found[i].id.value == expected[i].second);
          CHECK(found[i].distance == expected[i].first);
        }
      };
      for (int i = 0; i < 4 * size; ++i) {
        // Whole metres: many equal distances, many at the radius' very edge.
        const Eigen::Vector3d p(rng.uniform_index(20), rng.uniform_index(20), 0);
        poses.emplace_back(SO3d(), p);
        index.append(KeyframeId{i}, p);
        if (i % 16 == 0) check();
      }
      for (int moves = size; moves-- > 0;) {
        const auto i = static_cast<std::size_t>(rng.uniform_index(static_cast<Index>(poses.size())));
        poses[i] = SE3d(SO3d(), {rng.uniform(-40, 40), rng.uniform(-40, 40), rng.uniform(-40, 40)});
        index.move(KeyframeId{static_cast<Index>(i)}, poses[i].translation());
        check();
      }
      for (SE3d& pose : poses) pose = SE3d(SO3d(), pose.translation() + Eigen::Vector3d(rng.normal(), 1, 0));
      index.rebuild(keyframes_at(poses));
      check();
      CHECK(index.size() == poses.size());
    });
  }

  TEST_CASE("only what it holds is moved, wherever positions lie") {
    PositionIndex index;
    index.append(KeyframeId{3}, {0, 0, 0});
    index.append(KeyframeId{8}, {1e12, 0, -1e300});
    index.move(KeyframeId{5}, {1, 0, 0});
    CHECK(index.size() == 2);
    CHECK(index.within({0, 0, 0}, 2).size() == 1);
    index.move(KeyframeId{8}, {-1, 0, 0});
    CHECK(index.within({0, 0, 0}, 2).size() == 2);
    CHECK(index.within({0, 0, 0}, 1e9).size() == 2);  // a radius of many cubes
    CHECK_FALSE(index.contains(KeyframeId{5}));
  }

  TEST_CASE("an empty index finds nothing") { CHECK(PositionIndex().within({0, 0, 0}, 100).empty()); }
}
