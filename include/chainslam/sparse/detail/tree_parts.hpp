#pragma once

#include <algorithm>
#include <array>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/detail/supernodes.hpp"

namespace chainslam::detail {

/// Some supernodes of a tree, in the order of their elimination, and where their updates wait until their parents take
/// them.
///
/// In a postorder, the updates of even levels and those of odd levels form a stack each, and a supernode takes from the
/// one while it gives to the other. What a part's topmost supernodes leave to another part stays on its stacks.
struct TreePart {
  std::vector<Index> supernodes;
  std::array<Table<double>, 2> stacks;
  Index bad_column = -1;  ///< the first whose pivot is bad, in the order of elimination; -1: none

  /// Takes the memory for the updates.
  /// @param for_each_child  (s, visit) calls visit(child) for each of a supernode's children that is in this part.
  /// @param update_size  of a supernode, in coefficients.
  template <class ForEachChild, class UpdateSize>
  void take_memory(const Supernodes& nodes, ForEachChild&& for_each_child, UpdateSize&& update_size) {
    std::array<Offset, 2> top{0, 0};
    std::array<Offset, 2> highest{0, 0};
    for (const Index s : supernodes) {
      const std::size_t own = nodes.odd_level[s];
      top[own] += update_size(s);
      highest[own] = std::max(highest[own], top[own]);
      for_each_child(s, [&](Index child) { top[1 - own] -= update_size(child); });
    }
    for (std::size_t parity = 0; parity < 2; ++parity) stacks[parity].resize(highest[parity]);
  }
};

/// Divides a tree into parts of whole subtrees, to be factorized at the same time, and what is above them. Depends on
/// the tree alone, never on the number of threads.
///
/// @param size       number of its nodes, children before parents.
/// @param parent_of  a node's parent, -1 at a root.
/// @param work       of a node's factorization.
/// @returns the part of each node: 0, 1, ... of subtrees, heavier ones first; -1 above.
template <class ParentOf, class Work>
[[nodiscard]] Table<Index> divide_tree(Index size, ParentOf&& parent_of, Work&& work) {
  constexpr double most_parts = 32.0;
  Table<double> below(size, 0.0);  // work of the whole subtree
  double total = 0.0;
  for (Index s = 0; s < size; ++s) {
    const Index parent = parent_of(s);
    below[s] += work(s);
    total += work(s);
    if (parent != -1) below[parent] += below[s];
  }
  Table<Index> part(size, -1);
  std::vector<double> sums;
  // From the root down, each node after its parent; subtrees that follow each other share a part while it is light.
  for (Index s = size - 1; s >= 0; --s) {
    const Index parent = parent_of(s);
    if (parent != -1 && part[parent] != -1) {
      part[s] = part[parent];
    } else if (below[s] * most_parts <= 2.0 * total) {
      if (sums.empty() || sums.back() * most_parts >= total) sums.push_back(0.0);
      sums.back() += below[s];
      part[s] = to_index(sums.size()) - 1;
    }
  }
  std::vector<Index> by_work(sums.size());
  for (std::size_t k = 0; k < sums.size(); ++k) by_work[k] = static_cast<Index>(k);
  std::stable_sort(by_work.begin(), by_work.end(), [&](Index a, Index b) {
    return sums[static_cast<std::size_t>(a)] > sums[static_cast<std::size_t>(b)];
  });
  std::vector<Index> rank(sums.size());
  for (std::size_t k = 0; k < sums.size(); ++k) rank[static_cast<std::size_t>(by_work[k])] = static_cast<Index>(k);
  for (Index& of : part) {
    if (of != -1) of = rank[static_cast<std::size_t>(of)];
  }
  return part;
}

/// The nodes of each part, in their order; last, of what is above all.
[[nodiscard]] inline std::vector<std::vector<Index>> list_parts(const Table<Index>& part_of) {
  Index parts = 0;
  for (const Index part : part_of) parts = std::max(parts, part + 1);
  std::vector<std::vector<Index>> nodes(static_cast<std::size_t>(parts) + 1);
  for (Index s = 0; s < to_index(part_of.size()); ++s)
    nodes[static_cast<std::size_t>(part_of[s] == -1 ? parts : part_of[s])].push_back(s);
  return nodes;
}

}  // namespace chainslam::detail
