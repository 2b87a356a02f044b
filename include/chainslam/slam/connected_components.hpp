#pragma once

#include <cassert>
#include <cstddef>
#include <iterator>
#include <numeric>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/slam/adjacency_graph.hpp"

namespace chainslam {

/// The connected components of a graph whose edges come one after another.
///
/// A forest of nodes, joined by size, with path halving in `connect` (Tarjan and van Leeuwen 1984): n edges cost
/// O(n alpha(n)). The members of a component form a ring through the nodes, and two rings become one by swapping two
/// links. Const calls take O(log n) at worst, change nothing and may run on several threads, but not during a change.
class ConnectedComponents {
 public:
  /// Each node by itself.
  explicit ConnectedComponents(Index nodes = 0) { resize(nodes); }

  /// The components of a graph as it is.
  template <IncidenceGraph Graph>
  explicit ConnectedComponents(const Graph& graph) : ConnectedComponents(graph.node_count()) {
    for (Index node = 0; node < graph.node_count(); ++node)
      for (const auto& arc : graph.neighbors(node)) connect(node, arc.node);
  }

  [[nodiscard]] Index node_count() const { return static_cast<Index>(parent_.size()); }  ///< number of nodes
  /// How many components there are.
  [[nodiscard]] Index count() const { return count_; }

  /// Adds a node, a component by itself. @returns its number.
  Index add_node() {
    const Index added = node_count();
    resize(to_index(parent_.size() + 1, "ConnectedComponents"));
    return added;
  }

  /// Adds nodes until there are `nodes` of them.
  /// @throws std::invalid_argument if there are more already: none is ever taken out.
  void resize(Index nodes) {
    const Index before = node_count();
    if (nodes < before) throw std::invalid_argument("ConnectedComponents: resize cannot take nodes out");
    next_.resize(static_cast<std::size_t>(nodes));
    parent_.resize(static_cast<std::size_t>(nodes), -1);
    std::iota(next_.begin() + before, next_.end(), before);
    count_ += nodes - before;
    if (largest_ == -1 && nodes > 0) largest_ = 0;
  }

  /// Takes an edge. @returns whether it joined two components that were apart.
  bool connect(Index a, Index b) {
    if (parent(a) >= 0 && parent(a) == parent(b)) return false;  // most edges, once trees are low
    Index larger = halve_path(a);
    Index smaller = halve_path(b);
    if (larger == smaller) return false;
    if (parent(larger) > parent(smaller)) std::swap(larger, smaller);  // roots hold minus the size
    parent(larger) += parent(smaller);
    parent(smaller) = larger;
    std::swap(next_[static_cast<std::size_t>(larger)], next_[static_cast<std::size_t>(smaller)]);
    if (parent(larger) < parent(largest_)) largest_ = larger;
    --count_;
    return true;
  }

  /// The node that stands for the component of a node; the same for all its members until the next `connect`.
  [[nodiscard]] Index component_of(Index node) const {
    while (parent(node) >= 0) node = parent(node);
    return node;
  }
  /// Whether two nodes are in one component.
  [[nodiscard]] bool same(Index a, Index b) const { return component_of(a) == component_of(b); }
  /// How many nodes the component of a node has, itself included.
  [[nodiscard]] Index size_of(Index node) const { return -parent(component_of(node)); }
  /// The node that stands for the largest component, among equals the one that first had that size; -1 without nodes.
  [[nodiscard]] Index largest() const { return largest_; }

  class Members;
  /// The nodes of a component in O(size), beginning with the one given, in an order that the history of edges decides;
  /// a forward range, valid until the next change.
  [[nodiscard]] Members members(Index node) const;

 private:
  [[nodiscard]] Index& parent(Index node) {
    assert(node >= 0 && node < node_count());
    return parent_[static_cast<std::size_t>(node)];
  }
  [[nodiscard]] Index parent(Index node) const {
    assert(node >= 0 && node < node_count());
    return parent_[static_cast<std::size_t>(node)];
  }

  /// The root above a node; lets every second node on the way point to its grandparent.
  Index halve_path(Index node) {
    for (;;) {
      const Index above = parent(node);
      if (above < 0) return node;
      const Index grandparent = parent(above);
      if (grandparent < 0) return above;
      parent(node) = grandparent;
      node = grandparent;
    }
  }

  std::vector<Index> parent_;  ///< at a root: minus the size of its component
  std::vector<Index> next_;    ///< the next member of the component, in a ring; apart, for finding a root needs none
  Index count_ = 0;
  Index largest_ = -1;
};

/// The ring of a component's nodes, gone round once.
class ConnectedComponents::Members {
 public:
  /// Goes through the nodes of a component.
  class Iterator {
   public:
    using value_type = Index;                ///< a node
    using difference_type = std::ptrdiff_t;  ///< distance of iterators

    Iterator() = default;
    /// At a node of the circular list `next`.
    Iterator(const Index* next, Index node) : next_(next), node_(node), first_(node) {}

    Index operator*() const { return node_; }  ///< the node
    /// Goes to the next node.
    Iterator& operator++() {
      node_ = next_[node_];
      if (node_ == first_) node_ = -1;
      return *this;
    }
    /// Goes to the next node.
    Iterator operator++(int) {
      const Iterator before = *this;
      ++*this;
      return before;
    }
    /// Whether all members are equal.
    friend bool operator==(const Iterator& a, const Iterator& b) { return a.node_ == b.node_; }
    /// Whether all members are equal.
    friend bool operator==(const Iterator& a, std::default_sentinel_t) { return a.node_ == -1; }

   private:
    const Index* next_ = nullptr;
    Index node_ = -1;  ///< -1 at the end
    Index first_ = -1;
  };

  /// The component of a node in the circular list `next`.
  Members(const Index* next, Index node) : begin_(next, node) {}

  [[nodiscard]] Iterator begin() const { return begin_; }           ///< the first node
  [[nodiscard]] std::default_sentinel_t end() const { return {}; }  ///< behind the last node

 private:
  Iterator begin_;
};

inline ConnectedComponents::Members ConnectedComponents::members(Index node) const {
  assert(node >= 0 && node < node_count());
  return {next_.data(), node};
}

}  // namespace chainslam
