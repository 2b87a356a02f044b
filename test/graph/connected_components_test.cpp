#include "chainslam/slam/connected_components.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <iterator>
#include <numeric>
#include <vector>

#include "graph/random_graphs.hpp"

namespace chainslam {
namespace {

using test::Ends;
using test::for_all;

static_assert(std::forward_iterator<ConnectedComponents::Members::Iterator>);

/// Each node's component by name; joining two renames all of one.
struct PlainComponents {
  std::vector<Index> name;

  explicit PlainComponents(Index nodes) : name(static_cast<std::size_t>(nodes)) {
    std::iota(name.begin(), name.end(), 0);
  }
  [[nodiscard]] Index of(Index node) const { return name[static_cast<std::size_t>(node)]; }
  bool connect(Index a, Index b) {
    const Index from = of(a), to = of(b);
    std::ranges::replace(name, from, to);
    return from != to;
  }
  [[nodiscard]] std::vector<Index> members(Index node) const {
    std::vector<Index> nodes;
    for (Index i = 0; i < static_cast<Index>(name.size()); ++i)
      if (of(i) == of(node)) nodes.push_back(i);
    return nodes;
  }
  [[nodiscard]] Index count() const {
    std::vector<Index> names = name;
    std::ranges::sort(names);
    return static_cast<Index>(std::unique(names.begin(), names.end()) - names.begin());
  }
};

std::vector<Index> sorted_members(const ConnectedComponents& components, Index node) {
  std::vector<Index> members;
  for (const Index member : components.members(node)) members.push_back(member);
  std::ranges::sort(members);
  return members;
}

void check_same(const ConnectedComponents& components, const PlainComponents& plain) {
  const Index nodes = components.node_count();
  Index largest = 0;
  CHECK(components.count() == plain.count());
  for (Index node = 0; node < nodes; ++node) {
    const std::vector<Index> members = plain.members(node);
    REQUIRE(sorted_members(components, node) == members);
    CHECK(*components.members(node).begin() == node);
    CHECK(components.size_of(node) == static_cast<Index>(members.size()));
    CHECK(components.component_of(node) == components.component_of(members.front()));
    CHECK(components.same(node, 0) == (plain.of(node) == plain.of(0)));
    largest = std::max(largest, components.size_of(node));
  }
  CHECK(components.size_of(components.largest()) == largest);
  CHECK(components.component_of(components.largest()) == components.largest());
}

TEST_SUITE("graph/connected_components") {
  TEST_CASE("agree with renaming after every edge") {
    for_all(100, [](Rng& rng, int size) {
      const Index nodes = 1 + size / 2;
      ConnectedComponents components(nodes);
      PlainComponents plain(nodes);
      check_same(components, plain);
      for (const Ends& edge : test::random_edges(rng, nodes)) {
        CHECK(components.connect(edge.a, edge.b) == plain.connect(edge.a, edge.b));
        check_same(components, plain);
      }
    });
  }

  TEST_CASE("a graph's components are those of its edges") {
    for_all(100, [](Rng& rng, int size) {
      const std::vector<Ends> edges = test::random_edges(rng, size);
      PlainComponents plain(size);
      for (const Ends& edge : edges) plain.connect(edge.a, edge.b);
      check_same(ConnectedComponents(test::graph_of(size, edges)), plain);
    });
  }

  TEST_CASE("nodes may come between the edges") {
    ConnectedComponents components;
    CHECK(components.count() == 0);
    CHECK(components.largest() == -1);
    CHECK(components.add_node() == 0);
    CHECK(components.largest() == 0);
    components.resize(3);
    CHECK(components.connect(1, 2));
    CHECK(components.largest() == components.component_of(1));
    CHECK(components.add_node() == 3);
    CHECK_FALSE(components.connect(2, 1));
    CHECK_FALSE(components.connect(3, 3));
    CHECK(components.count() == 3);
    CHECK_THROWS_AS(components.resize(2), std::invalid_argument);
    CHECK_THROWS_AS(ConnectedComponents(-1), std::invalid_argument);
  }

  TEST_CASE("trees stay low: the depth is at most log2 of the size, whatever the order") {
    // Pairs of equals are joined, which makes the deepest trees; a path of 2^16 nodes is then asked for at every node.
    constexpr Index nodes = 1 << 16;
    ConnectedComponents components(nodes);
    for (Index step = 1; step < nodes; step *= 2)
      for (Index node = 0; node + step < nodes; node += 2 * step) CHECK(components.connect(node, node + step));
    CHECK(components.count() == 1);
    for (Index node = 0; node < nodes; ++node) REQUIRE(components.same(node, 0));
    CHECK(std::ranges::distance(components.members(7)) == nodes);
  }
}

}  // namespace
}  // namespace chainslam
