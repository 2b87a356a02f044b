#pragma once

#include <array>
#include <numeric>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/values.hpp"

namespace chainslam::detail {

/// Disjoint sets; the least member names a set. Near-constant time by path halving (Tarjan and van Leeuwen 1984).
class DisjointSets {
 public:
  explicit DisjointSets(Index size) : parent_(static_cast<std::size_t>(size)) {
    std::iota(parent_.begin(), parent_.end(), 0);
  }

  [[nodiscard]] Index find(Index i) {
    while (at(i) != i) i = at(i) = at(at(i));
    return i;
  }

  void join(Index a, Index b) {
    a = find(a);
    b = find(b);
    if (a != b) at(std::max(a, b)) = std::min(a, b);
  }

 private:
  [[nodiscard]] Index& at(Index i) { return parent_[static_cast<std::size_t>(i)]; }

  std::vector<Index> parent_;
};

/// The least key of each connected part of the graph that neither a unary factor nor a fixed variable holds in place.
template <class Graph>
[[nodiscard]] std::vector<Key> floating_components(const Graph& graph) {
  const Index size = graph.values().size();
  DisjointSets sets(size);
  std::vector<char> held(static_cast<std::size_t>(size), 0);
  graph.for_each_factor([&](const auto& factor) {
    const auto keys = factor.keys();
    if (keys.size() == 1) held[static_cast<std::size_t>(keys[0])] = 1;
    for (const Key key : keys) sets.join(keys[0], key);
  });
  std::vector<char> component_held(static_cast<std::size_t>(size), 0);
  for (Key key = 0; key < size; ++key) {
    if (held[static_cast<std::size_t>(key)] != 0 || graph.is_fixed(key))
      component_held[static_cast<std::size_t>(sets.find(key))] = 1;
  }
  std::vector<Key> floating;
  for (Key key = 0; key < size; ++key) {
    if (sets.find(key) == key && component_held[static_cast<std::size_t>(key)] == 0) floating.push_back(key);
  }
  return floating;
}

}  // namespace chainslam::detail
