#include "chainslam/registration/detail/match_cache.hpp"

#include <doctest/doctest.h>

#include "chainslam/registration/icp.hpp"
#include "chainslam/search/brute_force.hpp"
#include "chainslam/search/ikd_tree.hpp"
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

/// A target that forgets: every match is searched anew.
struct Forgetful {
  using Scalar = float;
  const IndexedCloud<>& cloud;

  [[nodiscard]] Index match(const Eigen::Vector3f& query, float max_distance) const {
    Neighbor<float> nearest;
    return cloud.knn(query, {&nearest, 1}, max_distance * 1.00001F) > 0 ? nearest.index : -1;
  }
  [[nodiscard]] const Eigen::Vector3f& position(Index i) const { return cloud.position(i); }
  [[nodiscard]] const Eigen::Vector3f& normal(Index i) const { return cloud.normal(i); }
  [[nodiscard]] std::size_t size() const { return cloud.size(); }
};
static_assert(MatchingTarget<Forgetful> && !NearestNeighborSearch<Forgetful>);

chainslam::detail::Placement placed(const SE3d& T) { return {T.rotation().matrix(), T.translation()}; }

/// Whether the match of every query is the nearest point: its index, to the bit.
template <class Search>
void check_against_fresh_searches(const Search& target, float max_distance) {
  for_all(30, [&](Rng& rng, int seed) {
    const auto queries =
        chainslam::detail::source_columns(sample(rng, yard(), 100, 0.3).positions, {.about_centroid = false});
    chainslam::detail::MatchCache<Search> cache(target, queries.count, max_distance);
    SE3d T;
    double size = 0.5;
    for (int iteration = 0; iteration < 12; ++iteration, size *= 0.5) {
      cache.update(queries, placed(T), 0, queries.count, iteration >= seed % 3);
      chainslam::detail::for_each_moved<float>(
          queries, placed(T), 0, queries.count, [&](Index i, const Eigen::Vector3f& query) {
            Neighbor<float> nearest;
            const bool found = target.knn(query, {&nearest, 1}, max_distance) > 0;
            const Index match = cache.index(i);
            if (found) {
              REQUIRE(match == nearest.index);
              REQUIRE(*cache.positions().at(2, i) == target.position(match)[2]);
            } else if (match >= 0) {  // the nearest one, too far away
              REQUIRE((target.position(match) - query).norm() > max_distance * 0.9999F);
            }
          });
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
    check_against_fresh_searches(IkdTree<float>(cloud), 0.5f);
  }

  TEST_CASE("a target of one point, which has no second to bound the way") {
    PointCloud<float> one;
    one.positions.push_back(Eigen::Vector3f(1, 2, 0));
    check_against_fresh_searches(KdTree<float>(one), 3.0f);
  }

  TEST_CASE("points that come twice, of which a search finds the same one each time") {
    Rng rng(3);
    PointCloud<float> cloud = sample(rng, yard(), 700, 0.02);
    const auto once = cloud.positions;
    cloud.positions.insert(cloud.positions.end(), once.begin(), once.end());
    check_against_fresh_searches(KdTree<float>(cloud), 1.0f);
  }

  TEST_CASE("searches nothing anew when nothing moves, little when little moves") {
    Rng rng(2);
    const CountingSearch target(sample(rng, yard(), 2000));
    const auto queries = chainslam::detail::source_columns(sample(rng, yard(), 500).positions, {});
    chainslam::detail::MatchCache<CountingSearch> cache(target, 500, 1.0f);
    const auto run = [&](double shift) {
      target.searches = 0;
      cache.update(queries, {Eigen::Matrix3d::Identity(), queries.pivot + Eigen::Vector3d::Constant(shift)}, 0, 500,
                   true);
      return target.searches;
    };
    CHECK(run(0.0) == 500);
    CHECK(run(0.0) == 0);
    CHECK(run(0.001) == 0);
    CHECK(run(0.05) < 50);  // spacing is 0.4 m, and four candidates are known
  }

  TEST_CASE("an alignment with cached matches is, to the bit, the one that searches all anew") {
    for_all(6, [](Rng& rng, int) {
      PointCloud<float> cloud = sample(rng, yard(), 4000, 0.02);
      const IndexedCloud<> target(cloud);
      const SE3d truth = random_motion(rng, 2.0, 1.0);
      PointCloud<float> source = seen_from(sample(rng, yard(), 1000, 0.02), truth);
      const SE3d guess = truth * random_motion(rng, 0.4, 0.05);
      const Icp<PointToPlane, Huber> icp{.kernel = {.width = 0.1}};
      const AlignResult cached = icp.align(source, target, guess);
      const AlignResult fresh = icp.align(source, Forgetful{target}, guess);
      CHECK(cached.iterations > 2);
      CHECK(cached.iterations == fresh.iterations);
      CHECK(cached.T_target_source == fresh.T_target_source);
      CHECK(cached.hessian == fresh.hessian);
      CHECK(cached.inliers == fresh.inliers);
      CHECK(cached.mean_squared_error == fresh.mean_squared_error);
    });
  }
}

}  // namespace chainslam::test
