#pragma once

#include <algorithm>
#include <cstddef>
#include <span>
#include <vector>

#include "chainslam/graph/adjacency_graph.hpp"
#include "chainslam/graph/concepts.hpp"

namespace chainslam {

/// A visitor that keeps a search's tree: how each node was reached, along a shortest path from the start.
///
/// Parents come before their children, so that what is composed along the paths, such as relative poses, takes one
/// pass over the steps. Use one for each search; derive from it to add events.
template <class Edge>
class BfsTree {
 public:
  /// A node of the tree and how it was reached.
  struct Step {
    Index node = -1;    ///< the node
    Index parent = -1;  ///< position in `steps()`; -1 at the start
    Edge edge{};        ///< from the parent; none at the start
  };

  /// Called by the search: a node was reached.
  void discover(Index node) {
    if (steps_.empty()) steps_.push_back({node, -1, {}});
  }
  void examine(Index /*node*/) { ++examined_; }  ///< called by the search: a node is looked at
  /// Called by the search: an arc leads to a new node.
  void tree_edge(Index /*from*/, const Arc<Edge>& arc) { steps_.push_back({arc.node, examined_ - 1, arc.edge}); }

  /// In the order of discovery, the start first.
  [[nodiscard]] std::span<const Step> steps() const { return steps_; }

  /// The positions of the steps from the start to the one given, both included.
  [[nodiscard]] std::vector<Index> path_to(Index step) const {
    std::vector<Index> path;
    for (; step != -1; step = steps_[static_cast<std::size_t>(step)].parent) path.push_back(step);
    std::reverse(path.begin(), path.end());
    return path;
  }

 private:
  std::vector<Step> steps_;
  Index examined_ = 0;  ///< nodes are examined in the order of discovery: the one being expanded is the last of these
};
static_assert(BfsVisitor<BfsTree<NoLabel>, AdjacencyGraph<>>);

}  // namespace chainslam
