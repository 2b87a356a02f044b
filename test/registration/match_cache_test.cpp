#include "chainslam/registration/detail/match_cache.hpp"

#include <doctest/doctest.h>

#include "chainslam/search/brute_force.hpp"
#include "chainslam/search/kd_tree.hpp"
#include "chainslam/search/voxel_map.hpp"
#include "registration/scenes.hpp"
#include "support/property.hpp"

namespace chainslam::test {
namespace {

/// A search that counts what it is asked.
struct CountingSearch : BruteForce<float> {
  using BruteForce<float>::BruteForce;
  mutable int searches = 0;
  Index knn(const Eigen::Vector3f& query, std::span<Neighbor<float>> out, float max_distance) const {
    ++searches;
    return BruteForce<float>::knn(query, out, max_distance);
  }
};

/// The distance to the nearest point within `max_distance`, or -1.
template <class Search>
float nearest_squared_distance(const Search& search, const Eigen::Vector3f& query, float max_distance) {
  Neighbor<float> nearest;
  if (search.knn(query, {&nearest, 1}, max_distance) == 0) return -1;
  return nearest.squared_distance;
}

template <class Search>
void check_against_fresh_searches(const Search& target, float max_distance) {
  for_all(30, [&](Rng& rng, int) {
    const PointCloud<float> queries = sample(rng, yard(), 100, 0.3);
    chainslam::detail::MatchCache<Search> cache(target, to_index(queries.size()), max_distance);
    SE3d T;
    double size = 0.5;
    for (int iteration = 0; iteration < 12; ++iteration, size *= 0.5) {
      for (std::size_t i = 0; i < queries.size(); ++i) {
        const Eigen::Vector3f query = (T * position(queries, i)).cast<float>();
        const auto match = cache.find(static_cast<Index>(i), query);
        const float expected = nearest_squared_distance(target, query, max_distance);
        if (match.index < 0)
          CHECK(expected < 0);
        else
          CHECK(match.squared_distance == doctest::Approx(expected).epsilon(1e-5).scale(1e-4));
      }
      T = T.retract(random_motion(rng, size, size * 0.05).log());
    }
  });
}

}  // namespace

TEST_SUITE("registration/match_cache") {
  TEST_CASE("says what a fresh search would say, whatever the way the queries took") {
    Rng rng(1);
    const PointCloud<float> cloud = sample(rng, yard(), 1500, 0.02);
    for (const float max_distance : {0.1f, 0.5f, 2.0f, std::numeric_limits<float>::infinity()}) {
      CAPTURE(max_distance);
      check_against_fresh_searches(KdTree<float>(cloud), max_distance);
    }
    check_against_fresh_searches(VoxelMap<float>(cloud), 0.3f);
  }

  TEST_CASE("a target of one point, which has no second to bound the way") {
    PointCloud<float> one;
    one.positions.push_back(Eigen::Vector3f(1, 2, 0));
    check_against_fresh_searches(KdTree<float>(one), 3.0f);
  }

  TEST_CASE("searches nothing anew when nothing moves, little when little moves") {
    Rng rng(2);
    const CountingSearch target(sample(rng, yard(), 2000));
    const PointCloud<float> queries = sample(rng, yard(), 500);
    chainslam::detail::MatchCache<CountingSearch> cache(target, 500, 1.0f);
    const auto run = [&](double shift) {
      target.searches = 0;
      for (std::size_t i = 0; i < queries.size(); ++i)
        (void)cache.find(static_cast<Index>(i),
                         queries.positions[i] + Eigen::Vector3f::Constant(static_cast<float>(shift)));
      return target.searches;
    };
    CHECK(run(0.0) == 500);
    CHECK(run(0.0) == 0);
    CHECK(run(0.001) < 50);  // spacing is 0.4 m: few have two neighbours equally far within 3 mm
  }
}

}  // namespace chainslam::test
