#pragma once

#include <concepts>
#include <iterator>
#include <utility>

#include "chainslam/core/types.hpp"

namespace chainslam {

/// A graph that can be walked: nodes 0 .. node_count() - 1.
///
/// Law: `neighbors(a)` is a range of the arcs that leave node a, each with the `node` it leads to, in an order that
/// stays the same while the graph does. It costs O(1) to have and O(degree) to go through.
template <class G>
concept IncidenceGraph = requires(const G& graph, Index node) {
  { graph.node_count() } -> std::same_as<Index>;
  { std::begin(graph.neighbors(node)) } -> std::forward_iterator;
  { (*std::begin(graph.neighbors(node))).node } -> std::convertible_to<Index>;
};

/// What the arcs of a graph are.
template <IncidenceGraph G>
using ArcOf = std::iter_value_t<decltype(std::begin(std::declval<const G&>().neighbors(Index{})))>;

/// What becomes of a node that a search is about to expand.
enum class BfsAction {
  expand,  ///< go through its arcs
  skip,    ///< do not
  stop,    ///< end the search
};

namespace detail {

template <class T, class... Types>
concept OneOf = (std::same_as<T, Types> || ...);

// A visitor hears an event if it has a member for it with a type that means something.
template <class V>
concept HearsDiscover = requires(V& visitor, Index node) {
  { visitor.discover(node) } -> OneOf<void, bool>;
};
template <class V>
concept HearsExamine = requires(V& visitor, Index node) {
  { visitor.examine(node) } -> OneOf<void, BfsAction>;
};
template <class V, class G>
concept HearsFollow = requires(V& visitor, Index from, const ArcOf<G>& arc) {
  { visitor.follow(from, arc) } -> OneOf<bool>;
};
template <class V, class G>
concept HearsTreeEdge = requires(V& visitor, Index from, const ArcOf<G>& arc) {
  { visitor.tree_edge(from, arc) } -> OneOf<void>;
};
template <class V>
concept HearsFinish = requires(V& visitor, Index node) {
  { visitor.finish(node) } -> OneOf<void>;
};

// An event that is named but cannot be heard is a mistake (members that are templates or overloaded go unseen here).
template <class V>
concept DiscoverIsRight = HearsDiscover<V> || !requires {
  &V::discover;
};
template <class V>
concept ExamineIsRight = HearsExamine<V> || !requires {
  &V::examine;
};
template <class V, class G>
concept FollowIsRight = HearsFollow<V, G> || !requires {
  &V::follow;
};
template <class V, class G>
concept TreeEdgeIsRight = HearsTreeEdge<V, G> || !requires {
  &V::tree_edge;
};
template <class V>
concept FinishIsRight = HearsFinish<V> || !requires {
  &V::finish;
};

template <class V, class G>
concept HearsSomething =
    HearsDiscover<V> || HearsExamine<V> || HearsFollow<V, G> || HearsTreeEdge<V, G> || HearsFinish<V>;

}  // namespace detail

/// Callbacks for the events of a breadth-first search of a graph G. One or more of these; those that are not written
/// cost nothing:
/// - `void discover(Index node)`, or `bool`: the node was reached, the start included, each once, nearest first; false
///   ends the search.
/// - `void examine(Index node)`, or `BfsAction`: the node's arcs are next; in the order of discovery.
/// - `bool follow(Index from, const Arc& arc)`: whether the arc counts; asked of every arc of an expanded node.
/// - `void tree_edge(Index from, const Arc& arc)`: the arc led to a node not reached before, which is discovered next.
/// - `void finish(Index node)`: the node's arcs have been gone through.
/// Law: events do not change the graph.
template <class V, class G>
concept BfsVisitor =
    IncidenceGraph<G> && detail::HearsSomething<V, G> && detail::DiscoverIsRight<V> && detail::ExamineIsRight<V> &&
    detail::FollowIsRight<V, G> && detail::TreeEdgeIsRight<V, G> && detail::FinishIsRight<V>;

}  // namespace chainslam
