#include "chainslam/slam/adjacency_graph.hpp"

#include <doctest/doctest.h>

#include <limits>
#include <utility>
#include <vector>

#include "graph/random_graphs.hpp"

namespace chainslam {
namespace {

using test::Ends;
using test::for_all;

using Lists = std::vector<std::vector<std::pair<Index, Index>>>;  // for each node its neighbours and the edges to them

Lists lists_of(const AdjacencyGraph<Index>& graph) {
  Lists lists;
  for (Index node = 0; node < graph.node_count(); ++node) {
    lists.emplace_back();
    for (const Arc<Index>& arc : graph.neighbors(node)) lists.back().emplace_back(arc.node, arc.edge);
  }
  return lists;
}

bool joins(const std::vector<Ends>& edges, Index a, Index b) {
  for (const Ends& edge : edges)
    if ((edge.a == a && edge.b == b) || (edge.a == b && edge.b == a)) return true;
  return false;
}

TEST_SUITE("graph/adjacency_graph") {
  TEST_CASE("arcs are those of lists that were appended to, in that order, while nodes and edges come by turns") {
    for_all(300, [](Rng& rng, int size) {
      AdjacencyGraph<Index> graph;
      Lists plain;
      Index edges = 0;
      for (int step = 0; step < 20 * size; ++step) {
        if (plain.empty() || rng.uniform() < 0.1) {
          CHECK(graph.add_node() == static_cast<Index>(plain.size()));
          plain.emplace_back();
          continue;
        }
        const Index nodes = static_cast<Index>(plain.size());
        const Index a = rng.uniform() < 0.3 ? 0 : rng.uniform_index(nodes);  // one node with many
        const Index b = rng.uniform() < 0.1 ? a : rng.uniform_index(nodes);
        graph.add_edge(a, b, edges);
        plain[static_cast<std::size_t>(a)].emplace_back(b, edges);
        plain[static_cast<std::size_t>(b)].emplace_back(a, edges);
        ++edges;
      }
      REQUIRE(lists_of(graph) == plain);
      CHECK(graph.edge_count() == edges);
      Index degrees = 0;
      for (Index node = 0; node < graph.node_count(); ++node) degrees += graph.degree(node);
      CHECK(degrees == 2 * edges);
    });
  }

  TEST_CASE("connected says whether there is an edge, from both sides") {
    for_all(100, [](Rng& rng, int size) {
      const std::vector<Ends> edges = test::random_edges(rng, size);
      const AdjacencyGraph<Index> graph = test::graph_of(size, edges);
      for (int i = 0; i < 200; ++i) {
        const Index a = rng.uniform_index(size), b = rng.uniform_index(size);
        CHECK(graph.connected(a, b) == joins(edges, a, b));
        CHECK(graph.connected(a, b) == graph.connected(b, a));
      }
    });
  }

  TEST_CASE("a loop is two arcs of its node; a repeated edge is two edges") {
    AdjacencyGraph<Index> graph(3);
    graph.add_edge(1, 1, 7);
    CHECK(graph.degree(1) == 2);
    CHECK(graph.connected(1, 1));
    CHECK_FALSE(graph.connected(0, 0));
    graph.add_edge(0, 2, 8);
    graph.add_edge(2, 0, 9);
    CHECK(lists_of(graph) == Lists{{{2, 8}, {2, 9}}, {{1, 7}, {1, 7}}, {{0, 8}, {0, 9}}});
    CHECK(graph.edge_count() == 3);
  }

  TEST_CASE("what is not there is refused and changes nothing") {
    AdjacencyGraph<> graph(2);
    graph.add_edge(0, 1);
    CHECK_THROWS_AS(graph.add_edge(0, 2), std::invalid_argument);
    CHECK_THROWS_AS(graph.add_edge(-1, 0), std::invalid_argument);
    CHECK_THROWS_AS(graph.resize(1), std::invalid_argument);
    CHECK_THROWS_AS(AdjacencyGraph<>(-1), std::invalid_argument);
    CHECK_THROWS_AS(graph.reserve(-1, 0), std::invalid_argument);
    CHECK(graph.node_count() == 2);
    CHECK(graph.edge_count() == 1);
    CHECK(graph.degree(0) == 1);
    CHECK(AdjacencyGraph<>().node_count() == 0);
  }

  TEST_CASE("resize adds nodes without edges and keeps the others") {
    AdjacencyGraph<Index> graph(2);
    graph.add_edge(0, 1, 5);
    graph.resize(4);
    CHECK(lists_of(graph) == Lists{{{1, 5}}, {{0, 5}}, {}, {}});
  }

  TEST_CASE("room that was made is enough for a ring") {
    constexpr Index nodes = 1000;
    AdjacencyGraph<Index> graph;
    graph.reserve(nodes, nodes);
    const std::size_t before = graph.memory();
    graph.resize(nodes);
    for (Index node = 0; node < nodes; ++node) graph.add_edge(node, (node + 1) % nodes, node);
    CHECK(graph.memory() == before);
  }

  TEST_CASE("slabs that nodes have grown out of are used again") {
    // Each node grows to 64 arcs in its turn: the slabs of 4, 8, 16 and 32 that it leaves serve the next one.
    constexpr Index nodes = 1000, degree = 64;
    AdjacencyGraph<Index> graph(nodes);
    for (Index node = 0; node < nodes; ++node)
      for (Index i = 0; i < degree / 2; ++i) graph.add_edge(node, node, i);
    CHECK(graph.memory() <= 3 * sizeof(Arc<Index>) * nodes * degree);
    for (Index node = 0; node < nodes; ++node)
      for (Index i = 0; i < degree; ++i) REQUIRE(graph.neighbors(node)[static_cast<std::size_t>(i)].edge == i / 2);
  }

  TEST_CASE("an edge without a label takes no room") {
    CHECK(sizeof(Arc<>) == sizeof(Index));
    CHECK(sizeof(Arc<Index>) == 2 * sizeof(Index));
  }
}

}  // namespace
}  // namespace chainslam
