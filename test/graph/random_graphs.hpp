#pragma once

#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/slam/adjacency_graph.hpp"
#include "support/property.hpp"

namespace chainslam::test {

struct Ends {
  Index a;
  Index b;
};

/// Edges between `nodes` nodes, loops and repeated ones among them; few enough that much is not connected, often.
inline std::vector<Ends> random_edges(Rng& rng, Index nodes) {
  std::vector<Ends> edges;
  const Index count = rng.uniform_index(2 * nodes + 1);
  while (static_cast<Index>(edges.size()) < count) {
    const Index a = rng.uniform_index(nodes);
    edges.push_back({a, rng.uniform() < 0.1 ? a : rng.uniform_index(nodes)});
    if (rng.uniform() < 0.1) edges.push_back({edges.back().b, edges.back().a});
  }
  return edges;
}

/// The graph of these edges, each with its position as its label.
inline AdjacencyGraph<Index> graph_of(Index nodes, const std::vector<Ends>& edges) {
  AdjacencyGraph<Index> graph(nodes);
  Index position = 0;
  for (const Ends& edge : edges) graph.add_edge(edge.a, edge.b, position++);
  return graph;
}

}  // namespace chainslam::test
