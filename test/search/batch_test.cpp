#include "chainslam/search/batch.hpp"

#include <doctest/doctest.h>

#include <limits>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/search/brute_force.hpp"
#include "chainslam/search/kd_tree.hpp"
#include "chainslam/search/voxel_map.hpp"
#include "search/search_laws.hpp"

namespace chainslam {
namespace {

using test::Points;
using test::same_distance;

using test::unlimited;

Points<float> random_points(Rng& rng, int count) {
  return test::repeat<float>(count, [&](int) { return test::random_point<float>(rng, 9, 9, 2); });
}

void check_rows(const NeighborRows<float>& rows, const BruteForce<float>& reference, const Points<float>& queries,
                float max_distance) {
  REQUIRE(rows.rows() == static_cast<Index>(queries.size()));
  std::vector<Neighbor<float>> expected(static_cast<std::size_t>(rows.k()));
  for (Index i = 0; i < rows.rows(); ++i) {
    const Index found = reference.knn(queries[static_cast<std::size_t>(i)], expected, max_distance);
    REQUIRE(static_cast<Index>(rows[i].size()) == found);
    for (std::size_t j = 0; j < rows[i].size(); ++j)
      CHECK(same_distance(rows[i][j].squared_distance, expected[j].squared_distance));
  }
}

bool same_bytes(const NeighborRows<float>& a, const NeighborRows<float>& b) {
  if (a.rows() != b.rows() || a.k() != b.k()) return false;
  for (Index i = 0; i < a.rows(); ++i) {
    if (a[i].size() != b[i].size()) return false;
    for (std::size_t j = 0; j < a[i].size(); ++j)
      if (a[i][j].index != b[i][j].index || a[i][j].squared_distance != b[i][j].squared_distance) return false;
  }
  return true;
}

TEST_SUITE("search/batch") {
  TEST_CASE("knn_batch finds what knn finds, in any order of the queries, also where fewer than k are near") {
    test::for_all(30, [](Rng& rng, int size) {
      const Points<float> points = random_points(rng, 20 * size), queries = random_points(rng, 10 * size);
      const BruteForce<float> reference(points);
      const KdTree<float> tree(points);
      NeighborRows<float> rows;
      for (const Index k : {1, 5, 12}) {
        for (const float max_distance : {unlimited, 0.7f}) {
          knn_batch(tree, queries, k, max_distance, rows);
          check_rows(rows, reference, queries, max_distance);
        }
      }
    });
  }

  TEST_CASE("asked again for queries that moved, it finds what knn finds, whatever has become of the points since") {
    test::for_all(30, [](Rng& rng, int size) {
      const Points<float> points = random_points(rng, 20 * size);
      Points<float> queries = random_points(rng, 10 * size);
      VoxelMap<float, FirstInVoxel> map(points, {.voxel_size = 0.4});
      NeighborRows<float> rows;
      knn_batch(map, queries, 5, unlimited, rows);
      for (int round = 0; round < 4; ++round) {
        for (auto& query : queries) query += test::random_point<float>(rng, 0.2, 0.2, 0.2);
        if (round == 1) map.erase_nearer_than(test::random_point<float>(rng, 9, 9, 2), 5);
        if (round == 2) map.insert(random_points(rng, 10 * size));
        Points<float> left;
        map.for_each_point([&](Index, const Eigen::Vector3f& p) { left.push_back(p); });
        knn_batch_again(map, queries, unlimited, rows);
        check_rows(rows, BruteForce<float>(left), queries, unlimited);
      }
    });
  }

  TEST_CASE("within_batch lists what within finds") {
    Rng rng(4);
    const Points<float> points = random_points(rng, 3000), queries = random_points(rng, 700);
    const KdTree<float> tree(points);
    NeighborLists<float> lists;
    within_batch(tree, queries, 0.8f, lists);
    std::vector<Neighbor<float>> expected;
    for (std::size_t i = 0; i < queries.size(); ++i) {
      tree.within(queries[i], 0.8f, expected);
      const auto found = lists[static_cast<Index>(i)];
      REQUIRE(found.size() == expected.size());
      for (std::size_t j = 0; j < found.size(); ++j) CHECK(found[j].index == expected[j].index);
    }
  }

  TEST_CASE("one thread and many give the same bytes") {
    Rng rng(3);
    const auto on_grid = [](Points<float> points) {
      for (auto& p : points) p = (2 * p).array().round() / 2;  // full of ties
      return points;
    };
    const Points<float> points = on_grid(random_points(rng, 4000)), queries = random_points(rng, 3000);
    const KdTree<float> tree(points);
    NeighborRows<float> serial, threaded;
    NeighborLists<float> serial_lists, threaded_lists;
    knn_batch(tree, queries, 5, unlimited, serial);
    within_batch(tree, queries, 0.6f, serial_lists);
    for (const int threads : {2, 5}) {
      ThreadPool pool(threads);
      knn_batch(tree, queries, 5, unlimited, threaded, pool);
      CHECK(same_bytes(serial, threaded));
      knn_batch_again(tree, queries, unlimited, threaded, pool);
      within_batch(tree, queries, 0.6f, threaded_lists, pool);
      CHECK(threaded_lists.first == serial_lists.first);
      for (std::size_t i = 0; i < serial_lists.neighbors.size(); ++i)
        REQUIRE(threaded_lists.neighbors[i].index == serial_lists.neighbors[i].index);
    }
  }

  TEST_CASE("no queries, no points, no room") {
    NeighborRows<float> rows;
    NeighborLists<float> lists;
    const KdTree<float> empty;
    knn_batch(empty, Points<float>{}, 5, unlimited, rows);
    CHECK(rows.rows() == 0);
    knn_batch(empty, Points<float>{{1, 2, 3}}, 5, unlimited, rows);
    CHECK(rows[0].empty());
    knn_batch(KdTree<float>(Points<float>{{1, 2, 3}}), Points<float>{{1, 2, 3}}, 0, unlimited, rows);
    CHECK(rows[0].empty());
    within_batch(empty, Points<float>{}, 1, lists);
    CHECK(lists.first.size() == 1);
    CHECK_THROWS_AS(rows.resize(1, -1), std::invalid_argument);
  }
}

}  // namespace
}  // namespace chainslam
