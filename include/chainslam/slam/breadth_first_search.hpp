#pragma once

#include <algorithm>
#include <cassert>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <span>
#include <stdexcept>
#include <type_traits>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/slam/adjacency_graph.hpp"

namespace chainslam {

/// How far a search goes.
struct BfsLimits {
  Index max_depth = std::numeric_limits<Index>::max();  ///< edges from the start; nodes that far are not expanded
  Index max_nodes = std::numeric_limits<Index>::max();  ///< reached, the start included
};

/// Why a search ended.
enum class BfsEnd {
  exhausted,    ///< nothing is left that can be reached
  stopped,      ///< the visitor said so
  depth_limit,  ///< nodes at max_depth were not expanded
  node_limit,   ///< a further node was met when max_nodes had been reached
};

/// What a search did.
struct BfsResult {
  Index nodes = 0;                 ///< reached, the start included
  Index depth = 0;                 ///< edges from the start to the last of them
  BfsEnd end = BfsEnd::exhausted;  ///< why it ended
};

/// Buffers of searches, to be used again: a search then costs its component and not the graph. One for each thread.
///
/// A node's mark is one bit, taken away before the next search by going through what the last one reached: the marks
/// of a million nodes fit a processor's own cache, and no stamp can wrap.
class BfsWorkspace {
 public:
  /// What the last search reached, in the order of discovery; valid until the next one.
  [[nodiscard]] std::span<const Index> reached() const { return {queue_.get(), static_cast<std::size_t>(reached_)}; }

  /// How many that are, and the i-th of them.
  [[nodiscard]] Index count() const { return reached_; }
  /// The node that was reached as number i.
  [[nodiscard]] Index operator[](Index i) const { return queue_[static_cast<std::size_t>(i)]; }

  /// Bytes held.
  [[nodiscard]] std::size_t memory() const {
    return static_cast<std::size_t>(marks_.capacity()) * sizeof(std::uint64_t) +
           static_cast<std::size_t>(capacity_) * sizeof(Index);
  }

  /// Forgets the last search and reserves memory for a graph of that many nodes. For those who write searches.
  void begin(Index nodes) {
    clear_marks();
    if (nodes > capacity_) grow(nodes);
  }

  /// Appends the node to `reached()` unless it is there. @returns whether it was not.
  bool reach(Index node) {
    assert(node >= 0 && node < capacity_);
    std::uint64_t& word = marks_[word_of(node)];
    const std::uint64_t bit = bit_of(node);
    if ((word & bit) != 0) return false;
    word |= bit;
    queue_[static_cast<std::size_t>(reached_++)] = node;
    return true;
  }

  /// Whether the last search has reached a node.
  [[nodiscard]] bool has_reached(Index node) const {
    return node < capacity_ && (marks_[word_of(node)] & bit_of(node)) != 0;
  }

 private:
  static Offset word_of(Index node) { return static_cast<std::uint32_t>(node) / 64; }
  static std::uint64_t bit_of(Index node) { return std::uint64_t{1} << (static_cast<std::uint32_t>(node) % 64); }

  void clear_marks() {
    if (reached_ >= marks_.size()) {
      marks_.assign(marks_.size(), 0);
    } else {
      for (const Index node : reached()) marks_[word_of(node)] = 0;
    }
    reached_ = 0;
  }

  void grow(Index nodes) {
    const std::size_t most = std::max(static_cast<std::size_t>(nodes), 2 * static_cast<std::size_t>(capacity_));
    const auto capacity = static_cast<Index>(std::min(most, std::size_t{std::numeric_limits<Index>::max()}));
    queue_ = std::make_unique_for_overwrite<Index[]>(static_cast<std::size_t>(capacity));
    marks_.resize(word_of(capacity) + 1);
    capacity_ = capacity;
  }

  std::unique_ptr<Index[]> queue_;      ///< nodes in the order of discovery: the search's queue is its answer
  detail::Table<std::uint64_t> marks_;  ///< one bit for each node, set if it is in the queue
  Index capacity_ = 0;
  Index reached_ = 0;
};

namespace detail {

/// One search on its way.
template <class Graph, class Visitor>
class BreadthFirstSearch {
 public:
  BreadthFirstSearch(const Graph& graph, Visitor& visitor, const BfsLimits& limits, BfsWorkspace& workspace)
      : graph_(graph), visitor_(visitor), limits_(limits), workspace_(workspace) {}

  BfsResult run(Index start) {
    workspace_.begin(graph_.node_count());
    workspace_.reach(start);
    if (!discover(start)) return result(BfsEnd::stopped);
    for (Index next = 0; next < workspace_.count(); ++depth_) {
      if (depth_ == limits_.max_depth) return result(BfsEnd::depth_limit);
      for (const Index level_end = workspace_.count(); next < level_end; ++next) {
        look_ahead(next);
        if (!take_up(workspace_[next])) return result(end_);
      }
    }
    return result(BfsEnd::exhausted);
  }

 private:
  using Arc = ArcOf<Graph>;

  [[nodiscard]] BfsResult result(BfsEnd end) const { return {workspace_.count(), depth_of_last_, end}; }

  static constexpr bool can_prefetch = requires(const Graph& graph, Index node) {
    graph.prefetch_node(node), graph.prefetch_arcs(node);
  };

  /// Has the memory of a node fetched that was just reached: in a large graph each lies somewhere else. (These two are
  /// inlined always: g++ 12 leaves out calls of functions that only prefetch.)
  [[gnu::always_inline]] void prefetch(Index node) const {
    if constexpr (can_prefetch) graph_.prefetch_node(node);
  }

  /// The same for the arcs of nodes that come soon, and again for nodes of which it may have been long ago.
  [[gnu::always_inline]] void look_ahead(Index next) {
    if constexpr (can_prefetch) {
      constexpr Index steps = 4;
      const Index soon = std::min(next + steps + 1, workspace_.count());
      for (; fetched_ < soon; ++fetched_) graph_.prefetch_arcs(workspace_[fetched_]);
      if (next + 2 * steps < workspace_.count()) graph_.prefetch_node(workspace_[next + 2 * steps]);
    }
  }

  /// Goes through a node's arcs. @returns false if that ends the search; `end_` then says why.
  bool take_up(Index node) {
    const BfsAction action = examine(node);
    if (action == BfsAction::stop) return false;
    if (action == BfsAction::skip) return true;
    for (const Arc& arc : graph_.neighbors(node))
      if (!take(node, arc)) return false;
    if constexpr (HandlesFinish<Visitor>) visitor_.finish(node);
    return true;
  }

  bool take(Index from, const Arc& arc) {
    if constexpr (HandlesFollow<Visitor, Graph>)
      if (!visitor_.follow(from, arc)) return true;
    if (workspace_.has_reached(arc.node)) return true;
    if (workspace_.count() >= limits_.max_nodes) {
      end_ = BfsEnd::node_limit;
      return false;
    }
    workspace_.reach(arc.node);
    prefetch(arc.node);
    depth_of_last_ = depth_ + 1;
    if constexpr (HandlesTreeEdge<Visitor, Graph>) visitor_.tree_edge(from, arc);
    return discover(arc.node);
  }

  bool discover(Index node) {
    if constexpr (requires { requires std::same_as<decltype(visitor_.discover(node)), bool>; }) {
      return visitor_.discover(node);
    } else if constexpr (HandlesDiscover<Visitor>) {
      visitor_.discover(node);
    }
    return true;
  }

  BfsAction examine(Index node) {
    if constexpr (requires { requires std::same_as<decltype(visitor_.examine(node)), BfsAction>; }) {
      return visitor_.examine(node);
    } else if constexpr (HandlesExamine<Visitor>) {
      visitor_.examine(node);
    }
    return BfsAction::expand;
  }

  const Graph& graph_;
  Visitor& visitor_;
  const BfsLimits limits_;
  BfsWorkspace& workspace_;
  Index depth_ = 0;          ///< of the nodes being expanded
  Index depth_of_last_ = 0;  ///< of the node reached last
  Index fetched_ = 0;        ///< nodes whose arcs are in the processor's cache, or on their way
  BfsEnd end_ = BfsEnd::stopped;
};

/// Is content to know what a search reached.
struct NullVisitor {
  void finish(Index /*node*/) const {}
};

/// Follows the arcs whose edges it is given.
template <class Keep>
struct EdgeFilter {
  const Keep& keep;

  template <class Arc>
  bool follow(Index /*from*/, const Arc& arc) const {
    return keep(arc.edge);
  }
};

}  // namespace detail

/// Visits what can be reached from `start`, nearest nodes first, and notifies the visitor.
///
/// Costs O(nodes reached + their arcs), whatever the size of the graph. The order is that in which arcs were added:
/// the same graph gives the same events.
/// @param workspace  gives what was reached afterwards: `workspace.reached()`.
/// @throws std::invalid_argument if `start` is not in the graph, max_depth is negative or max_nodes less than 1. What
/// an event throws comes through; graph and workspace can be used as before.
template <IncidenceGraph Graph, class Visitor>
BfsResult breadth_first_search(const Graph& graph, Index start, Visitor&& visitor, const BfsLimits& limits,
                               BfsWorkspace& workspace) {
  using Events = std::remove_reference_t<Visitor>;
  static_assert(BfsVisitor<Events, Graph>,
                "breadth_first_search: Visitor needs one or more of `void or bool discover(Index)`, `void or BfsAction "
                "examine(Index)`, `bool follow(Index, const Arc&)`, `void tree_edge(Index, const Arc&)`, `void "
                "finish(Index)`, and none of them with other types; see chainslam/slam/adjacency_graph.hpp");
  if constexpr (BfsVisitor<Events, Graph>) {
    if (start < 0 || start >= graph.node_count())
      throw std::invalid_argument("breadth_first_search: the start is not in the graph");
    if (limits.max_depth < 0 || limits.max_nodes < 1)
      throw std::invalid_argument("breadth_first_search: max_depth must not be negative, max_nodes at least 1");
    return detail::BreadthFirstSearch<Graph, Events>(graph, visitor, limits, workspace).run(start);
  }
}

/// The nodes that can be reached from `start`, itself included, nearest first. For one go: it makes a workspace of its
/// own, one bit for each node of the graph.
/// @throws std::invalid_argument as `breadth_first_search`.
template <IncidenceGraph Graph>
[[nodiscard]] std::vector<Index> reachable(const Graph& graph, Index start, const BfsLimits& limits = {}) {
  BfsWorkspace workspace;
  breadth_first_search(graph, start, detail::NullVisitor{}, limits, workspace);
  return {workspace.reached().begin(), workspace.reached().end()};
}

/// The same along the edges only for which `keep(edge)` is true: those of some kinds, say.
template <IncidenceGraph Graph, std::predicate<const decltype(ArcOf<Graph>::edge)&> Keep>
[[nodiscard]] std::vector<Index> reachable(const Graph& graph, Index start, const Keep& keep,
                                           const BfsLimits& limits = {}) {
  BfsWorkspace workspace;
  breadth_first_search(graph, start, detail::EdgeFilter<Keep>{keep}, limits, workspace);
  return {workspace.reached().begin(), workspace.reached().end()};
}

}  // namespace chainslam
