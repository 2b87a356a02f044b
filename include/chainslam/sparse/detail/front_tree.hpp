#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/detail/arena.hpp"
#include "chainslam/sparse/detail/front.hpp"

namespace chainslam::detail {

/// What has to be done again at a front: of those that are none, all fronts above are none too.
enum class Stale : std::uint8_t { none, numbers, order };

/// The fronts of a factorization whose tree changes, and which variable is eliminated in which.
template <int B>
class FrontTree {
 public:
  struct Node {
    Index parent = -1;
    Index first_child = -1;
    Index last_child = -1;
    Index next = -1;  ///< sibling
    Index previous = -1;
    Index columns = 0;
    Index rows = 0;
    Index waits_for = 0;  ///< children that are not ready
    Stale stale = Stale::none;
    Index* variables = nullptr;  ///< own columns, then rows
    double* data = nullptr;
    double* update = nullptr;  ///< what it leaves to its parent; null where that is not kept
    double lowered = 0.0;      ///< what its elimination lowers the squared error by
    double excess = 0.0;       ///< what keeping an old solution of its columns raises it by
    double work = 0.0;         ///< multiplications of its factorization and all below
  };

  void add_variable() { node_of_.push_back(-1); }
  void drop_last_variable() { node_of_.pop_back(); }

  /// The node in which a variable is eliminated, -1 if it is not.
  [[nodiscard]] Index node_of(Index variable) const { return node_of_[variable]; }
  void set_node_of(Index variable, Index node) { node_of_[variable] = node; }

  [[nodiscard]] Node& operator[](Index node) { return nodes_[node]; }
  [[nodiscard]] const Node& operator[](Index node) const { return nodes_[node]; }

  /// A node without parent and children; its variables and numbers are not yet set.
  [[nodiscard]] Index create(Index columns, Index rows) {
    Index node = to_index(nodes_.size());
    if (free_.size() > 0) {
      node = free_.back();
      free_.pop_back();
    } else {
      nodes_.push_back({});
    }
    Node& created = nodes_[node];
    created = Node{};
    created.columns = columns;
    created.rows = rows;
    created.variables = lists_.take(columns + rows);
    return node;
  }

  void release(Index node) {
    Node& released = nodes_[node];
    if (has_numbers(node)) release_numbers(node);
    lists_.give_back(released.variables, released.columns + released.rows);
    free_.push_back(node);
  }

  /// The numbers alone: not initialized when they are taken again.
  void release_numbers(Index node) {
    if (has_update(node)) release_update(node);
    panels_.give_back(nodes_[node].data, panel_size(node));
    nodes_[node].data = nullptr;
  }
  /// Takes what is not there.
  void take_numbers(Index node) {
    Node& of = nodes_[node];
    if (of.data == nullptr) of.data = panels_.take(panel_size(node), node);
    if (of.update == nullptr) of.update = updates_.take(update_size(node), node);
  }
  void release_update(Index node) {
    updates_.give_back(nodes_[node].update, update_size(node));
    nodes_[node].update = nullptr;
  }
  /// All updates, and their memory.
  void release_updates() {
    for (Index node = 0; node < size(); ++node) nodes_[node].update = nullptr;
    updates_ = {};
  }
  [[nodiscard]] bool has_update(Index node) const { return nodes_[node].update != nullptr; }
  /// Moves some fronts' numbers together, where much lies idle between them.
  void compact() {
    panels_.compact([&](Index node, double* data) { nodes_[node].data = data; });
    updates_.compact([&](Index node, double* update) { nodes_[node].update = update; });
  }
  [[nodiscard]] bool has_numbers(Index node) const { return nodes_[node].data != nullptr; }

  void append_child(Index parent, Index child) {
    Node& above = nodes_[parent];
    Node& below = nodes_[child];
    below.parent = parent;
    below.next = -1;
    below.previous = above.last_child;
    (above.last_child == -1 ? above.first_child : nodes_[above.last_child].next) = child;
    above.last_child = child;
  }
  void drop_children(Index node) { nodes_[node].first_child = nodes_[node].last_child = -1; }

  [[nodiscard]] Front<B> front(Index node) const {
    const Node& of = nodes_[node];
    return Front<B>(of.data, of.update, of.columns, of.rows);
  }
  [[nodiscard]] std::span<const Index> variables(Index node) const {
    return {nodes_[node].variables, static_cast<std::size_t>(nodes_[node].columns + nodes_[node].rows)};
  }
  [[nodiscard]] std::span<const Index> columns(Index node) const {
    return variables(node).first(static_cast<std::size_t>(nodes_[node].columns));
  }
  [[nodiscard]] std::span<const Index> rows(Index node) const {
    return variables(node).subspan(static_cast<std::size_t>(nodes_[node].columns));
  }

  /// Nodes, be they in use or not.
  [[nodiscard]] Index size() const { return to_index(nodes_.size()); }

  /// All but the fronts' numbers.
  /// @param released  nodes that are taken as if they had been released, in this order.
  void save(ByteSink& out, std::span<const Index> released) const {
    out.put_list(node_of_);
    out.put(static_cast<std::uint64_t>(nodes_.size()));
    for (Index node = 0; node < size(); ++node) {
      const Node& saved = nodes_[node];
      out.put(has_numbers(node) ? saved.columns : Index{-1});
      if (!has_numbers(node)) continue;
      for (const Index index :
           {saved.rows, saved.parent, saved.first_child, saved.last_child, saved.next, saved.previous})
        out.put(index);
      for (const Index variable : variables(node)) out.put(variable);
      out.put(saved.lowered);
      out.put(saved.excess);
      out.put(saved.work);
      out.put(static_cast<std::uint8_t>(has_update(node)));
    }
    Table<Index> unused = free_;
    unused.append(released);
    out.put_list(unused);
  }
  /// What `save` wrote, into an empty tree. The fronts' numbers are not initialized, and their updates all there.
  /// @returns the nodes whose update was not kept.
  [[nodiscard]] std::vector<Index> load(ByteSource& in) {
    std::vector<Index> without_update;
    in.take_list(node_of_);
    nodes_.resize(static_cast<Offset>(in.take<std::uint64_t>()));
    for (Index node = 0; node < size(); ++node) {
      Node& loaded = nodes_[node];
      loaded.columns = in.take<Index>();
      if (loaded.columns < 0) continue;
      for (Index* const index :
           {&loaded.rows, &loaded.parent, &loaded.first_child, &loaded.last_child, &loaded.next, &loaded.previous})
        *index = in.take<Index>();
      loaded.variables = lists_.take(loaded.columns + loaded.rows);
      for (Index k = 0; k < loaded.columns + loaded.rows; ++k) loaded.variables[k] = in.take<Index>();
      loaded.lowered = in.take<double>();
      loaded.excess = in.take<double>();
      loaded.work = in.take<double>();
      if (in.take<std::uint8_t>() == 0) without_update.push_back(node);
      take_numbers(node);
    }
    in.take_list(free_);
    return without_update;
  }

  /// Bytes taken from the system for numbers and lists.
  [[nodiscard]] Offset bytes() const {
    return (panels_.capacity() + updates_.capacity()) * static_cast<Offset>(sizeof(double)) +
           lists_.capacity() * static_cast<Offset>(sizeof(Index));
  }
  /// Of those, what holds numbers and lists.
  [[nodiscard]] Offset used_bytes() const {
    return (panels_.used() + updates_.used()) * static_cast<Offset>(sizeof(double)) +
           lists_.used() * static_cast<Offset>(sizeof(Index));
  }

 private:
  [[nodiscard]] Offset panel_size(Index node) const { return Front<B>::size(nodes_[node].columns, nodes_[node].rows); }
  [[nodiscard]] Offset update_size(Index node) const {
    return Front<B>::update_size(nodes_[node].columns, nodes_[node].rows);
  }

  Table<Index> node_of_;
  Table<Node> nodes_;
  Table<Index> free_;
  Arena<Index> lists_;
  Arena<double, true> panels_;
  Arena<double, true> updates_;  ///< apart, since they come and go and panels stay
};

}  // namespace chainslam::detail
