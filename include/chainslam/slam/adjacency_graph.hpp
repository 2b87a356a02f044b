#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cassert>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <span>
#include <stdexcept>
#include <type_traits>
#include <utility>

#include "chainslam/core/table.hpp"
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
concept HandlesDiscover = requires(V& visitor, Index node) {
  { visitor.discover(node) } -> OneOf<void, bool>;
};
template <class V>
concept HandlesExamine = requires(V& visitor, Index node) {
  { visitor.examine(node) } -> OneOf<void, BfsAction>;
};
template <class V, class G>
concept HandlesFollow = requires(V& visitor, Index from, const ArcOf<G>& arc) {
  { visitor.follow(from, arc) } -> OneOf<bool>;
};
template <class V, class G>
concept HandlesTreeEdge = requires(V& visitor, Index from, const ArcOf<G>& arc) {
  { visitor.tree_edge(from, arc) } -> OneOf<void>;
};
template <class V>
concept HandlesFinish = requires(V& visitor, Index node) {
  { visitor.finish(node) } -> OneOf<void>;
};

// An event that is named but cannot be heard is a mistake (members that are templates or overloaded go unseen here).
template <class V>
concept ValidDiscover = HandlesDiscover<V> || !requires {
  &V::discover;
};
template <class V>
concept ValidExamine = HandlesExamine<V> || !requires {
  &V::examine;
};
template <class V, class G>
concept ValidFollow = HandlesFollow<V, G> || !requires {
  &V::follow;
};
template <class V, class G>
concept ValidTreeEdge = HandlesTreeEdge<V, G> || !requires {
  &V::tree_edge;
};
template <class V>
concept ValidFinish = HandlesFinish<V> || !requires {
  &V::finish;
};

template <class V, class G>
concept HandlesEvents =
    HandlesDiscover<V> || HandlesExamine<V> || HandlesFollow<V, G> || HandlesTreeEdge<V, G> || HandlesFinish<V>;

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
concept BfsVisitor = IncidenceGraph<G> && detail::HandlesEvents<V, G> && detail::ValidDiscover<V> &&
    detail::ValidExamine<V> && detail::ValidFollow<V, G> && detail::ValidTreeEdge<V, G> && detail::ValidFinish<V>;

/// An edge about which nothing is known but its ends; takes no memory.
struct NoLabel {
  friend bool operator==(NoLabel, NoLabel) = default;  ///< whether all members are equal
};

/// One direction of an edge, as seen from the node that it leaves.
template <class Edge = NoLabel>
struct Arc {
  Index node = -1;                    ///< where it leads
  [[no_unique_address]] Edge edge{};  ///< what the arc carries
};

/// An undirected multigraph that grows: nodes 0 .. n-1, edges with a label, both directions of each stored.
///
/// Adding a node or an edge is O(1) amortised. A node's arcs lie side by side, in the order in which they were added,
/// in a slab of one array for all; a full slab moves to one twice as long, and what it leaves is used again. A loop
/// (a, a) is two arcs of a, so that degrees sum to twice the number of edges; repeated edges are kept.
/// Const calls may run on several threads, but not during a change.
/// @tparam Edge  what each edge carries, given back with both directions; small and trivially copyable: such as the
///               position of a closure in a list.
template <class Edge = NoLabel>
class AdjacencyGraph {
  static_assert(std::is_trivially_copyable_v<Edge> && std::is_default_constructible_v<Edge>,
                "AdjacencyGraph: Edge needs to be trivially copyable and default constructible: store a position in a "
                "list of your own in place of the thing itself");

 public:
  using Arc = chainslam::Arc<Edge>;  ///< an arc and the node that it leads to

  explicit AdjacencyGraph(Index nodes = 0) { resize(nodes); }  ///< a graph of so many nodes without edges

  [[nodiscard]] Index node_count() const { return static_cast<Index>(nodes_.size()); }  ///< number of nodes
  [[nodiscard]] Index edge_count() const { return edges_; }                             ///< number of edges
  /// Bytes held, free capacity included.
  [[nodiscard]] std::size_t memory() const {
    return static_cast<std::size_t>(nodes_.capacity()) * sizeof(Node) +
           static_cast<std::size_t>(arcs_.capacity()) * sizeof(Arc) + sizeof(*this);
  }

  /// Adds a node without edges. @returns its number.
  Index add_node() {
    const Index added = to_index(nodes_.size() + 1, "AdjacencyGraph: nodes") - 1;
    nodes_.push_back({});
    return added;
  }

  /// Adds nodes without edges until there are `nodes` of them.
  /// @throws std::invalid_argument if there are more already: nothing is ever taken out.
  void resize(Index nodes) {
    if (nodes < node_count()) throw std::invalid_argument("AdjacencyGraph: resize cannot take nodes out");
    nodes_.resize(nodes);
  }

  /// Reserves capacity for these numbers of nodes and edges, so that the arrays need not move.
  /// @throws std::invalid_argument if a number is negative.
  void reserve(Index nodes, Index edges) {
    if (nodes < 0 || edges < 0) throw std::invalid_argument("AdjacencyGraph: reserve needs numbers of 0 or more");
    nodes_.reserve(nodes);
    arcs_.reserve(Offset{4} * edges);
  }

  /// Connects two nodes.
  /// @throws std::invalid_argument if one of them is not there, or if the arcs outgrow `Index`; nothing has changed
  /// then.
  void add_edge(Index a, Index b, const Edge& edge = {}) {
    if (!contains(a) || !contains(b))
      throw std::invalid_argument("AdjacencyGraph: an edge to a node that is not there");
    make_room(a, b);
    append(a, Arc{b, edge});
    append(b, Arc{a, edge});
    ++edges_;
  }

  /// Whether there is such a node.
  [[nodiscard]] bool contains(Index node) const { return node >= 0 && node < node_count(); }

  /// The arcs that leave a node, in the order in which they were added; valid until the next change.
  [[nodiscard]] std::span<const Arc> neighbors(Index node) const {
    const Node& of = at(node);
    return {arcs_.data() + of.begin, of.degree};
  }

  /// Number of arcs at a node.
  [[nodiscard]] Index degree(Index node) const { return static_cast<Index>(at(node).degree); }

  /// Whether an edge joins the two; looks through the arcs of the one that has fewer.
  [[nodiscard]] bool connected(Index a, Index b) const {
    if (degree(b) < degree(a)) std::swap(a, b);
    for (const Arc& arc : neighbors(a))
      if (arc.node == b) return true;
    return false;
  }

  /// Prefetches a node's place in the table, or its arcs.
  [[gnu::always_inline]] void prefetch_node(Index node) const { __builtin_prefetch(nodes_.data() + node); }
  /// Asks the processor to fetch a node's arcs.
  [[gnu::always_inline]] void prefetch_arcs(Index node) const { __builtin_prefetch(arcs_.data() + at(node).begin); }

 private:
  /// A node's slab. Its length follows from the degree, see `capacity`.
  struct Node {
    std::uint32_t begin = 0;
    std::uint32_t degree = 0;
  };
  static constexpr std::uint32_t smallest = 4;  ///< arcs in a first slab
  static constexpr Index none = -1;

  static std::uint32_t capacity(std::uint32_t degree) {
    return degree == 0 ? 0 : std::max(smallest, std::bit_ceil(degree));
  }
  static std::size_t size_class(std::uint32_t capacity) { return static_cast<std::size_t>(std::countr_zero(capacity)); }

  [[nodiscard]] const Node& at(Index node) const {
    assert(contains(node));
    return nodes_[node];
  }

  /// How many arcs longer the array may get by one more arc of a node with this degree.
  static std::uint32_t growth(std::uint32_t degree) { return degree == capacity(degree) ? capacity(degree + 1) : 0; }

  /// Lets the array of arcs grow before anything else is changed, so that nothing can go wrong half-way.
  void make_room(Index a, Index b) {
    const Offset more = Offset{growth(at(a).degree)} + growth(at(b).degree + (a == b ? 1 : 0));
    if (arcs_.size() + more <= arcs_.capacity()) return;
    static_cast<void>(to_index(arcs_.size() + more, "AdjacencyGraph: arcs"));
    arcs_.reserve(std::max(arcs_.size() + more, 2 * arcs_.capacity()));
  }

  void append(Index node, const Arc& arc) {
    Node& of = nodes_[node];
    if (of.degree == capacity(of.degree)) move_to_longer_slab(of);
    arcs_[of.begin + of.degree] = arc;
    ++of.degree;
  }

  void move_to_longer_slab(Node& node) {
    const std::uint32_t old_capacity = node.degree;
    const std::uint32_t begin = take_slab(capacity(old_capacity + 1));
    std::copy_n(arcs_.begin() + node.begin, old_capacity, arcs_.begin() + begin);
    if (old_capacity > 0) give_back(node.begin, old_capacity);
    node.begin = begin;
  }

  /// Free slabs of one length form a list through the `node` of their first arcs.
  [[nodiscard]] std::uint32_t take_slab(std::uint32_t length) {
    Index& head = free_slabs_[size_class(length)];
    if (head == none) {
      const auto begin = static_cast<std::uint32_t>(arcs_.size());
      arcs_.resize(arcs_.size() + Offset{length});
      return begin;
    }
    const auto begin = static_cast<std::uint32_t>(head);
    head = arcs_[begin].node;
    return begin;
  }

  void give_back(std::uint32_t begin, std::uint32_t length) {
    Index& head = free_slabs_[size_class(length)];
    arcs_[begin].node = head;
    head = static_cast<Index>(begin);
  }

  static constexpr std::array<Index, 32> no_slabs() {
    std::array<Index, 32> heads{};
    heads.fill(none);
    return heads;
  }

  detail::Table<Node> nodes_;
  detail::Table<Arc> arcs_;                        ///< the slabs, those in use and the free ones
  std::array<Index, 32> free_slabs_ = no_slabs();  ///< for each length 2^k the first free one
  Index edges_ = 0;
};
static_assert(IncidenceGraph<AdjacencyGraph<>>);

}  // namespace chainslam
