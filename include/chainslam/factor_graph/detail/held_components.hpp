#pragma once

#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/values.hpp"

namespace chainslam::detail {

/// The connected parts of a growing graph, and which of them something holds in place. The least key names a part.
class HeldComponents {
 public:
  void clear() {
    parent_.clear();
    held_.clear();
  }
  void add_variable() {
    parent_.push_back(to_index(parent_.size()));
    held_.push_back(0);
  }
  [[nodiscard]] Index size() const { return to_index(parent_.size()); }

  /// Near-constant time by path halving (Tarjan and van Leeuwen 1984).
  [[nodiscard]] Key find(Key key) {
    while (at(key) != key) key = at(key) = at(at(key));
    return key;
  }
  void join(Key a, Key b) {
    a = find(a);
    b = find(b);
    if (a == b) return;
    if (b < a) std::swap(a, b);
    at(b) = a;
    if (held_[static_cast<std::size_t>(b)] != 0) hold(a);
  }
  /// Joins what a factor ties together; one on a single variable holds it in place.
  template <class Keys>
  void connect(const Keys& keys) {
    for (const Key key : keys) join(keys[0], key);
    if (keys.size() == 1) hold(keys[0]);
  }
  /// Says that something holds the part of a variable in place.
  void hold(Key key) { held_[static_cast<std::size_t>(find(key))] = 1; }
  [[nodiscard]] bool is_held(Key key) { return held_[static_cast<std::size_t>(find(key))] != 0; }

  /// The least key of each part that nothing holds.
  [[nodiscard]] std::vector<Key> floating() {
    std::vector<Key> keys;
    for (Key key = 0; key < size(); ++key) {
      if (find(key) == key && !is_held(key)) keys.push_back(key);
    }
    return keys;
  }

 private:
  [[nodiscard]] Key& at(Key key) { return parent_[static_cast<std::size_t>(key)]; }

  std::vector<Key> parent_;
  std::vector<char> held_;
};

/// The least key of each connected part of the graph that neither a unary factor nor a fixed variable holds in place.
template <class Graph>
[[nodiscard]] std::vector<Key> floating_components(const Graph& graph) {
  HeldComponents components;
  for (Key key = 0; key < graph.values().size(); ++key) components.add_variable();
  graph.for_each_factor([&](const auto& factor) { components.connect(factor.keys()); });
  for (Key key = 0; key < graph.values().size(); ++key) {
    if (graph.is_fixed(key)) components.hold(key);
  }
  return components.floating();
}

}  // namespace chainslam::detail
