#include "chainslam/slam/breadth_first_search.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <limits>
#include <queue>
#include <stdexcept>
#include <string>
#include <vector>

#include "graph/random_graphs.hpp"

namespace chainslam {
namespace {

using test::for_all;

using Graph = AdjacencyGraph<Index>;

/// The textbook's search, with a depth for each node of the graph.
struct PlainSearch {
  std::vector<Index> order;
  std::vector<Index> depth;  ///< -1 where not reached

  template <class Keep>
  PlainSearch(const Graph& graph, Index start, Index max_depth, const Keep& keep)
      : depth(static_cast<std::size_t>(graph.node_count()), -1) {
    std::queue<Index> open;
    open.push(start);
    depth[static_cast<std::size_t>(start)] = 0;
    for (; !open.empty(); open.pop()) {
      const Index node = open.front(), next = depth[static_cast<std::size_t>(node)] + 1;
      order.push_back(node);
      if (next > max_depth) continue;
      for (const Arc<Index>& arc : graph.neighbors(node)) {
        if (!keep(arc.edge) || depth[static_cast<std::size_t>(arc.node)] != -1) continue;
        depth[static_cast<std::size_t>(arc.node)] = next;
        open.push(arc.node);
      }
    }
  }
  PlainSearch(const Graph& graph, Index start, Index max_depth = std::numeric_limits<Index>::max())
      : PlainSearch(graph, start, max_depth, [](Index) { return true; }) {}
};

Graph random_graph(Rng& rng, int size) { return test::graph_of(size, test::random_edges(rng, size)); }

std::vector<Index> reached(const BfsWorkspace& workspace) {
  return {workspace.reached().begin(), workspace.reached().end()};
}

/// A ring of n nodes, 0 - 1 - ... - n-1 - 0.
Graph ring(Index nodes) {
  Graph graph(nodes);
  for (Index node = 0; node < nodes; ++node) graph.add_edge(node, (node + 1) % nodes, node);
  return graph;
}

/// Writes down what it hears.
struct Protocol {
  std::string text;

  void discover(Index node) { text += " d" + std::to_string(node); }
  void examine(Index node) { text += " e" + std::to_string(node); }
  bool follow(Index from, const Arc<Index>& arc) {
    text += " f" + std::to_string(from) + "-" + std::to_string(arc.node);
    return true;
  }
  void tree_edge(Index from, const Arc<Index>& arc) {
    text += " t" + std::to_string(from) + "-" + std::to_string(arc.node);
  }
  void finish(Index node) { text += " x" + std::to_string(node); }
};

struct Listener {
  void discover(Index /*node*/) {}
};

struct StopsAt {
  Index goal;
  bool discover(Index node) const { return node != goal; }
};

struct SkipsAbove {
  Index last;
  BfsAction examine(Index node) const { return node > last ? BfsAction::skip : BfsAction::expand; }
};

struct StopsBeforeExpanding {
  Index node;
  BfsAction examine(Index next) const { return next == node ? BfsAction::stop : BfsAction::expand; }
};

struct Throws {
  void finish(Index /*node*/) const { throw std::runtime_error("enough"); }
};

struct DiscoversDistances {
  void discover(Index node, double distance);
};
struct DiscoversNumbers {
  int discover(Index node);
};
struct HandlesNothing {
  void discovered(Index node);
};
struct RefusesArcs {
  void follow(Index from, const Arc<Index>& arc);
};
static_assert(BfsVisitor<Protocol, Graph> && BfsVisitor<const StopsAt, Graph> && BfsVisitor<Listener, Graph>);
static_assert(!BfsVisitor<DiscoversDistances, Graph> && !BfsVisitor<DiscoversNumbers, Graph>);
static_assert(!BfsVisitor<HandlesNothing, Graph> && !BfsVisitor<RefusesArcs, Graph>);
static_assert(!BfsVisitor<Listener, std::vector<Index>> && !IncidenceGraph<std::vector<Index>>);

TEST_SUITE("graph/breadth_first_search") {
  TEST_CASE("reaches what the textbook's search reaches, in its order, for one workspace through all searches") {
    BfsWorkspace workspace;
    for_all(200, [&](Rng& rng, int size) {
      const Graph graph = random_graph(rng, size);
      for (Index start = 0; start < size; ++start) {
        const PlainSearch plain(graph, start);
        const BfsResult result = breadth_first_search(graph, start, Listener{}, {}, workspace);
        REQUIRE(reached(workspace) == plain.order);
        CHECK(result.nodes == static_cast<Index>(plain.order.size()));
        CHECK(result.depth == std::ranges::max(plain.depth));
        CHECK(result.end == BfsEnd::exhausted);
        CHECK(reachable(graph, start) == plain.order);
        for (Index node = 0; node < size; ++node)
          CHECK(workspace.has_reached(node) == (plain.depth[static_cast<std::size_t>(node)] != -1));
      }
    });
  }

  TEST_CASE("limits of depth and number cut the textbook's order short") {
    BfsWorkspace workspace;
    for_all(200, [&](Rng& rng, int size) {
      const Graph graph = random_graph(rng, size);
      const Index start = rng.uniform_index(size);
      const PlainSearch whole(graph, start);
      const Index component = static_cast<Index>(whole.order.size());
      for (Index depth = 0; depth < 5; ++depth) {
        const PlainSearch plain(graph, start, depth);
        const BfsResult result = breadth_first_search(graph, start, Listener{}, {.max_depth = depth}, workspace);
        CHECK(reached(workspace) == plain.order);
        CHECK(result.depth == std::ranges::max(plain.depth));
        CHECK((result.end == BfsEnd::depth_limit) == (depth <= std::ranges::max(whole.depth)));
      }
      for (Index nodes = 1; nodes <= component + 1; ++nodes) {
        const BfsResult result = breadth_first_search(graph, start, Listener{}, {.max_nodes = nodes}, workspace);
        const std::vector<Index> first(whole.order.begin(), whole.order.begin() + std::min(nodes, component));
        CHECK(reached(workspace) == first);
        CHECK(result.end == (nodes < component ? BfsEnd::node_limit : BfsEnd::exhausted));
        CHECK(result.depth == whole.depth[static_cast<std::size_t>(first.back())]);
      }
    });
  }

  TEST_CASE("only edges of the kinds asked for are followed") {
    for_all(200, [](Rng& rng, int size) {
      const Graph graph = random_graph(rng, size);
      const Index start = rng.uniform_index(size);
      const auto keep = [](Index edge) { return edge % 3 != 0; };
      CHECK(reachable(graph, start, keep) == PlainSearch(graph, start, 1000, keep).order);
      CHECK(reachable(graph, start, keep, {.max_depth = 2}) == PlainSearch(graph, start, 2, keep).order);
      CHECK(reachable(graph, start, [](Index) { return false; }) == std::vector<Index>{start});
    });
  }

  TEST_CASE("events come in the order that is promised") {
    Graph graph(5);
    graph.add_edge(0, 2, 0);
    graph.add_edge(0, 1, 1);
    graph.add_edge(2, 1, 2);
    graph.add_edge(1, 1, 3);
    graph.add_edge(3, 4, 4);
    BfsWorkspace workspace;
    Protocol protocol;
    breadth_first_search(graph, 0, protocol, {}, workspace);
    CHECK(protocol.text ==
          " d0 e0 f0-2 t0-2 d2 f0-1 t0-1 d1 x0"
          " e2 f2-0 f2-1 x2"
          " e1 f1-0 f1-2 f1-1 f1-1 x1");
  }

  TEST_CASE("a visitor stops the search where it has found what it looked for") {
    const Graph graph = ring(100);
    BfsWorkspace workspace;
    const BfsResult found = breadth_first_search(graph, 0, StopsAt{3}, {}, workspace);
    CHECK(found.end == BfsEnd::stopped);
    CHECK(found.depth == 3);
    CHECK(reached(workspace) == std::vector<Index>{0, 1, 99, 2, 98, 3});
    CHECK(breadth_first_search(graph, 0, StopsAt{0}, {}, workspace).nodes == 1);
    CHECK(breadth_first_search(graph, 0, StopsBeforeExpanding{1}, {}, workspace).end == BfsEnd::stopped);
    CHECK(reached(workspace) == std::vector<Index>{0, 1, 99});
  }

  TEST_CASE("a node that a visitor skips is reached, but not what lies behind it") {
    BfsWorkspace workspace;
    const BfsResult result = breadth_first_search(ring(100), 0, SkipsAbove{5}, {}, workspace);
    CHECK(result.end == BfsEnd::exhausted);
    CHECK(result.depth == 6);
    CHECK(reached(workspace) == std::vector<Index>{0, 1, 99, 2, 3, 4, 5, 6});
  }

  TEST_CASE("thousands of searches, stopped, thrown out of and whole, on graphs that grow and change, leave no marks") {
    BfsWorkspace workspace;
    Rng rng(4);
    Graph growing = ring(10);
    for (int i = 0; i < 70'000; ++i) {
      if (i % 10 == 0) growing.add_edge(growing.add_node(), rng.uniform_index(growing.node_count()), i);
      const Index start = rng.uniform_index(growing.node_count());
      if (i % 3 == 0)
        CHECK_THROWS_AS(breadth_first_search(growing, start, Throws{}, {}, workspace), std::runtime_error);
      breadth_first_search(growing, start, StopsAt{5}, {.max_nodes = 50}, workspace);
      breadth_first_search(growing, start, Listener{}, {.max_depth = i % 4}, workspace);
      if (i % 500 == 0) {
        breadth_first_search(growing, start, Listener{}, {}, workspace);
        REQUIRE(reached(workspace) == PlainSearch(growing, start).order);
        const Graph small = ring(3);
        REQUIRE(breadth_first_search(small, 1, Listener{}, {}, workspace).nodes == 3);
      }
    }
  }

  TEST_CASE("a node by itself reaches itself; what makes no sense is refused") {
    const Graph graph(2);
    BfsWorkspace workspace;
    const BfsResult alone = breadth_first_search(graph, 1, Listener{}, {}, workspace);
    CHECK(alone.nodes == 1);
    CHECK(alone.depth == 0);
    CHECK(alone.end == BfsEnd::exhausted);
    CHECK(reachable(graph, 1) == std::vector<Index>{1});
    CHECK_THROWS_AS(breadth_first_search(graph, 2, Listener{}, {}, workspace), std::invalid_argument);
    CHECK_THROWS_AS(breadth_first_search(graph, -1, Listener{}, {}, workspace), std::invalid_argument);
    CHECK_THROWS_AS(breadth_first_search(graph, 0, Listener{}, {.max_depth = -1}, workspace), std::invalid_argument);
    CHECK_THROWS_AS(breadth_first_search(graph, 0, Listener{}, {.max_nodes = 0}, workspace), std::invalid_argument);
    CHECK_THROWS_AS(static_cast<void>(reachable(Graph(0), 0)), std::invalid_argument);
  }

  TEST_CASE("a workspace's room follows the graph, and searches do not add to it") {
    BfsWorkspace workspace;
    const Graph graph = ring(10'000);
    breadth_first_search(graph, 0, Listener{}, {.max_nodes = 3}, workspace);
    const std::size_t before = workspace.memory();
    for (Index start = 0; start < 100; ++start) breadth_first_search(graph, start, Listener{}, {}, workspace);
    CHECK(workspace.memory() == before);
    CHECK(before < 6 * 10'000);
  }
}

}  // namespace
}  // namespace chainslam
