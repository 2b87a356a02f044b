#include "chainslam/registration/consistency_graph.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <numeric>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/registration/graph_consensus.hpp"
#include "registration/scenes.hpp"
#include "support/property.hpp"
#include "support/threads_cases.hpp"

namespace chainslam::test {
namespace {

BitGraph random_graph(Rng& rng, Index size, double density) {
  BitGraph graph(size);
  for (Index i = 0; i < size; ++i)
    for (Index j = 0; j < i; ++j)
      if (rng.uniform() < density) graph.connect(i, j);
  return graph;
}

bool is_clique(const BitGraph& graph, const std::vector<Index>& vertices) {
  for (std::size_t a = 0; a < vertices.size(); ++a)
    for (std::size_t b = 0; b < a; ++b)
      if (!graph.connected(vertices[a], vertices[b])) return false;
  return true;
}

/// By trying all sets of vertices.
std::size_t largest_clique_by_force(const BitGraph& graph) {
  std::size_t most = 0;
  for (unsigned set = 0; set < 1U << graph.size(); ++set) {
    std::vector<Index> vertices;
    for (Index i = 0; i < graph.size(); ++i)
      if ((set >> i & 1U) != 0) vertices.push_back(i);
    if (vertices.size() > most && is_clique(graph, vertices)) most = vertices.size();
  }
  return most;
}

/// By taking vertices of few neighbours away until none is left.
std::vector<Index> cores_by_force(const BitGraph& graph) {
  std::vector<Index> cores(static_cast<std::size_t>(graph.size()), 0);
  std::vector<bool> left(static_cast<std::size_t>(graph.size()), true);
  for (Index k = 1; k <= graph.size(); ++k) {
    for (bool changed = true; changed;) {
      changed = false;
      for (Index i = 0; i < graph.size(); ++i) {
        if (!left[static_cast<std::size_t>(i)]) continue;
        Index degree = 0;
        for (Index j = 0; j < graph.size(); ++j) degree += left[static_cast<std::size_t>(j)] && graph.connected(i, j);
        if (degree >= k) continue;
        left[static_cast<std::size_t>(i)] = false;
        changed = true;
      }
    }
    for (std::size_t i = 0; i < left.size(); ++i)
      if (left[i]) cores[i] = k;
  }
  return cores;
}

MatchedPoints moved_points(Rng& rng, Index count, bool normals) {
  MatchedPoints points;
  const SE3d T = random_motion(rng, 50, 2);
  const auto direction = [&rng] { return Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()).normalized(); };
  for (Index i = 0; i < count; ++i) {
    const Eigen::Vector3d p(rng.uniform(-40, 40), rng.uniform(-40, 40), rng.uniform(-5, 5));
    const Eigen::Vector3d off(rng.normal(), rng.normal(), rng.normal());
    points.source.push_back(p);
    points.target.push_back(T * p + (i % 2 == 0 ? 0.05 : 5.0) * off);
    if (!normals) continue;
    points.source_normals.push_back(direction());
    points.target_normals.push_back(i % 4 == 0 ? T.rotation() * points.source_normals.back() : direction());
  }
  return points;
}

}  // namespace

TEST_SUITE("registration/consistency_graph") {
  THREADS_TEST_CASE("registration/consistency_graph",
                    "connects what distances and normals allow, as comparing them one "
                    "by one does") {
    for_all(20, [](Rng& rng, int size) {
      const bool normals = size % 2 == 0;
      const MatchedPoints points = moved_points(rng, 5 * size, normals);
      const ConsistencyOptions options{.max_stretch = 0.4, .least_distance = 2};
      const BitGraph graph = consistency_graph(points, options);
      REQUIRE(graph.size() == points.size());
      Index unclear = 0;
      for (Index i = 0; i < graph.size(); ++i) {
        CHECK(!graph.connected(i, i));
        for (Index j = 0; j < graph.size(); ++j) {
          if (i == j) continue;
          const auto a = static_cast<std::size_t>(i), b = static_cast<std::size_t>(j);
          const double source = (points.source[a] - points.source[b]).norm();
          const double target = (points.target[a] - points.target[b]).norm();
          const double stretch = std::abs(source - target), least = std::min(source, target);
          double gap = 0;
          if (normals)
            gap = std::abs(points.source_normals[a].dot(points.source_normals[b]) -
                           points.target_normals[a].dot(points.target_normals[b]));
          const bool expected = stretch <= 0.4 && least >= 2 && gap <= options.max_cosine_gap;
          const bool border = std::abs(stretch - 0.4) < 1e-3 || std::abs(least - 2) < 1e-4 ||
                              std::abs(gap - options.max_cosine_gap) < 1e-5;
          if (border)
            ++unclear;
          else
            CHECK(graph.connected(i, j) == expected);
          CHECK(graph.connected(i, j) == graph.connected(j, i));
        }
      }
      CHECK(unclear <= graph.size() * graph.size() / 100 + 4);
      const BitGraph parallel = consistency_graph(points, options, ThreadPool(3));
      for (Index i = 0; i < graph.size(); ++i) CHECK(std::ranges::equal(graph.row(i), parallel.row(i)));
    });
    CHECK(consistency_graph({}).size() == 0);
    CHECK_THROWS_AS((void)consistency_graph({}, {.max_stretch = 0}), std::invalid_argument);
  }

  TEST_CASE("core numbers are those of taking away vertices by hand") {
    for_all(30, [](Rng& rng, int size) {
      const BitGraph graph = random_graph(rng, 3 + size, rng.uniform(0.02, 0.6));
      const CoreNumbers cores = core_numbers(graph);
      const std::vector<Index> expected = cores_by_force(graph);
      CHECK(cores.of_vertex == expected);
      CHECK(cores.largest == *std::max_element(expected.begin(), expected.end()));
      CHECK(cores.order.size() == expected.size());
    });
    CHECK(core_numbers(BitGraph{}).order.empty());
  }

  TEST_CASE("the largest clique is found and proved in small graphs") {
    for_all(60, [](Rng& rng, int size) {
      const BitGraph graph = random_graph(rng, 1 + size % 14, rng.uniform(0.1, 0.95));
      const Clique clique = max_clique(graph, 2, 100'000);
      CHECK(is_clique(graph, clique.vertices));
      CHECK(std::is_sorted(clique.vertices.begin(), clique.vertices.end()));
      CHECK(clique.proved);
      CHECK(clique.vertices.size() == largest_clique_by_force(graph));
    });
    CHECK(max_clique(BitGraph{}).vertices.empty());
    CHECK(max_clique(BitGraph(5)).vertices.size() == 1);
  }

  TEST_CASE(
      "a clique hidden among a thousand vertices is found within the "
      "budget; less budget, no smaller a claim") {
    for_all(4, [](Rng& rng, int) {
      BitGraph graph = random_graph(rng, 1000, 0.08);
      std::vector<Index> hidden(1000);
      std::iota(hidden.begin(), hidden.end(), Index{0});
      for (std::size_t i = 999; i > 0; --i)
        std::swap(hidden[i], hidden[static_cast<std::size_t>(rng.uniform_index(static_cast<Index>(i) + 1))]);
      hidden.resize(40);
      std::sort(hidden.begin(), hidden.end());
      for (const Index a : hidden)
        for (const Index b : hidden)
          if (a < b) graph.connect(a, b);
      const Clique clique = max_clique(graph);
      CHECK(clique.proved);
      for (const Index vertex : hidden) CHECK(std::ranges::binary_search(clique.vertices, vertex));
      const Clique hasty = max_clique(random_graph(rng, 300, 0.7), 1, 3);
      CHECK(!hasty.proved);
      CHECK(hasty.vertices.size() > 8);
      const Clique late = max_clique(graph, 16, 500, Deadline::in(std::chrono::nanoseconds(0)));
      CHECK(is_clique(graph, late.vertices));
      CHECK(!late.vertices.empty());
    });
  }
}

}  // namespace chainslam::test
