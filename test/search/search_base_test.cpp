#include "chainslam/search/search_base.hpp"

#include <doctest/doctest.h>

#include "chainslam/search/brute_force.hpp"
#include "chainslam/search/ikd_tree.hpp"
#include "chainslam/search/indexed_cloud.hpp"
#include "chainslam/search/nanoflann_tree.hpp"
#include "chainslam/search/voxel_map.hpp"
#include "search/search_laws.hpp"

namespace chainslam::test {

TEST_SUITE("search/search_base") {
  TEST_CASE_TEMPLATE("knn and radius return what the calls that write to memory find, in order", Search, KdTree<float>,
                     IkdTree<float>, BruteForce<float>, NanoflannTree<float>, IndexedCloud<>,
                     VoxelMap<float, FirstInVoxel>) {
    for_all(30, [](Rng& rng, int size) {
      for (const auto& distribution : distributions<float>()) {
        const auto points = distribution.make(rng, size);
        const Search search = [&] {
          if constexpr (std::same_as<Search, IndexedCloud<>>)
            return Search(PointCloud<float>{.positions = points});
          else
            return Search(points);
        }();
        const Eigen::Vector3f query = random_point<float>(rng, 6, 6, 6);
        const float reach = static_cast<float>(rng.uniform(0, 8));
        for (const Index k : {0, 1, 5, 40}) {
          std::vector<Neighbor<float>> expected(static_cast<std::size_t>(k));
          expected.resize(static_cast<std::size_t>(search.knn(query, expected, reach)));
          const std::vector<Neighbor<float>> found = search.knn(query, k, reach);
          REQUIRE(found.size() == expected.size());
          for (std::size_t i = 0; i < found.size(); ++i)
            CHECK(found[i].squared_distance == expected[i].squared_distance);
        }
        CHECK(search.knn(query, 5).size() == std::min<std::size_t>(5, search.size()));
        std::vector<Neighbor<float>> all;
        search.within(query, reach, all);
        const std::vector<Neighbor<float>> found = search.radius(query, reach);
        REQUIRE(found.size() == all.size());
        for (std::size_t i = 0; i < found.size(); ++i) {
          CHECK((search.position(found[i].index) - query).norm() <= reach * 1.0001f);
          if (i > 0)
            CHECK(std::pair(found[i - 1].squared_distance, found[i - 1].index) <
                  std::pair(found[i].squared_distance, found[i].index));
        }
      }
    });
  }

  TEST_CASE("in the plane, too, and of nothing when the query is not a number") {
    const std::vector<Eigen::Vector2f> points{{0, 0}, {3, 0}, {1, 0}};
    const KdTree<float, 2> tree(points);
    const auto found = tree.knn({0.9f, 0}, 2);
    REQUIRE(found.size() == 2);
    CHECK(found[0].index == 2);
    CHECK(found[1].index == 0);
    CHECK(tree.radius({0, 0}, 1).size() == 2);  // the rim belongs to it
    CHECK(tree.knn({std::numeric_limits<float>::quiet_NaN(), 0}, 2).empty());
    CHECK(tree.radius({std::numeric_limits<float>::quiet_NaN(), 0}, 9).empty());
  }

  TEST_CASE("a negative number of neighbours is refused, and a huge one costs no memory") {
    const KdTree<float> tree(std::vector<Eigen::Vector3f>{{0, 0, 0}});
    CHECK_THROWS_AS((void)tree.knn({0, 0, 0}, -1), std::invalid_argument);
    CHECK(tree.knn({0, 0, 0}, std::numeric_limits<Index>::max()).capacity() == 1);
    CHECK(KdTree<float>().knn({0, 0, 0}, 3).empty());
  }
}

}  // namespace chainslam::test
