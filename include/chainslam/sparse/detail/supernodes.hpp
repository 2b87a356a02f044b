#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/block_matrix.hpp"
#include "chainslam/sparse/detail/elimination_tree.hpp"

namespace chainslam::detail {

/// All about a Cholesky factor that the values do not decide: the order of elimination, the columns that are factorized
/// together (supernodes), their rows, and how their updates flow up the tree (multifrontal method: Duff and Reid 1983,
/// Liu 1992). Supernodes and block columns are numbered in the order of elimination, which is a postorder of the tree.
struct Supernodes {
  Table<Index> order;         ///< of the block columns: order[k] is the caller's column eliminated as the k-th
  Table<Index> position;      ///< inverse of `order`
  Table<Index> first_column;  ///< of each supernode, and the number of columns after the last
  Table<Offset> row_start;    ///< into `rows` and `row_in_parent`, for each supernode
  Table<Index> rows;          ///< block rows below a supernode's own columns, ascending
  Table<Index>
      row_in_parent;    ///< for each entry of `rows`: its place in the parent's front (own columns, then its rows)
  Table<Index> parent;  ///< of each supernode; -1 at a root
  Table<Index> child_count;
  Table<std::uint8_t> odd_level;  ///< 1 where the level in the tree is odd (roots: 0)

  [[nodiscard]] Index size() const { return to_index(parent.size()); }
  [[nodiscard]] Index columns(Index s) const { return first_column[Offset{s} + 1] - first_column[s]; }
  [[nodiscard]] Index update_rows(Index s) const { return to_index(row_start[Offset{s} + 1] - row_start[s]); }
  [[nodiscard]] Index front_rows(Index s) const { return columns(s) + update_rows(s); }
  [[nodiscard]] std::span<const Index> rows_of(Index s) const {
    return rows.range(row_start[s], row_start[Offset{s} + 1]);
  }
  [[nodiscard]] std::span<const Index> rows_in_parent(Index s) const {
    return row_in_parent.range(row_start[s], row_start[Offset{s} + 1]);
  }
};

/// The pattern with columns renumbered: new column k is the old `order[k]`, and `position` is the inverse.
[[nodiscard]] inline BlockPattern permuted(const BlockPattern& pattern, const Table<Index>& position) {
  Table<BlockCoordinate> blocks;
  blocks.reserve(pattern.blocks());
  for (Index column = 0; column < pattern.size(); ++column) {
    for (const Index row : pattern.rows(column).subspan(1)) blocks.push_back({position[row], position[column]});
  }
  return BlockPattern(pattern.size(), blocks.all());
}

[[nodiscard]] inline Table<Index> inverse_permutation(const Table<Index>& order) {
  Table<Index> position(order.size());
  for (Index k = 0; k < to_index(order.size()); ++k) position[order[k]] = k;
  return position;
}

/// Joins columns that are worth factorizing together into supernodes.
///
/// A column joins its last child's supernode when their rows agree, or nearly so: zeros stored on purpose cost less
/// than many small fronts. The limits are those that measured best for pose graphs (`bench/sparse/cholesky_bench.cpp`).
class SupernodeJoiner {
 public:
  SupernodeJoiner(std::span<const Index> parents, std::span<const Index> counts, int block_size)
      : parents_(parents), counts_(counts), block_size_(block_size) {}

  /// @returns the first column of each supernode, and the number of columns at the end.
  [[nodiscard]] Table<Index> join() {
    for (Index column = 0; column < to_index(parents_.size()); ++column) {
      open_.push_back({column, 1, count(column), 0});
      while (open_.size() > 1 && try_join()) {
      }
    }
    Table<Index> first;
    first.reserve(open_.size() + 1);
    for (const Group& group : open_) first.push_back(group.first);
    first.push_back(to_index(parents_.size()));
    return first;
  }

 private:
  struct Group {
    Index first;
    Index columns;
    Index height;  ///< block rows of the first column, the group's own columns included
    Offset zeros;  ///< blocks stored that are zero
  };

  [[nodiscard]] Index count(Index column) const { return counts_[static_cast<std::size_t>(column)]; }

  [[nodiscard]] static Offset trapezoid(Offset columns, Offset height) {
    return columns * height - columns * (columns - 1) / 2;
  }

  /// Joins the last two groups if the last is the parent of the one before and the zeros are few.
  bool try_join() {
    const Group& parent = open_.back();
    const Group& child = open_[open_.size() - 2];
    const Index child_last = child.first + child.columns - 1;
    if (parents_[static_cast<std::size_t>(child_last)] != parent.first) return false;
    const Index columns = child.columns + parent.columns;
    const Index height = child.columns + parent.height;
    const Offset zeros = child.zeros + parent.zeros + Offset{child.columns} * (height - child.height);
    const double share = static_cast<double>(zeros) / static_cast<double>(trapezoid(columns, height));
    const Index scalar_columns = columns * block_size_;
    const bool join =
        zeros == 0 || (scalar_columns <= 12 && share < 0.3) || (scalar_columns <= 48 && share < 0.1) || share < 0.03;
    if (!join) return false;
    const Group joined{child.first, columns, height, zeros};
    open_.pop_back();
    open_.back() = joined;
    return true;
  }

  std::span<const Index> parents_;
  std::span<const Index> counts_;
  int block_size_;
  Table<Group> open_;
};

/// Fills the rows of all supernodes: the union of their columns' and their children's rows.
inline void find_rows(const BlockPattern& pattern, std::span<const Index> column_parents, Supernodes& nodes) {
  const Index count = nodes.size();
  Table<Index> supernode_of(pattern.size());
  for (Index s = 0; s < count; ++s) {
    for (Index column = nodes.first_column[s]; column < nodes.first_column[Offset{s} + 1]; ++column)
      supernode_of[column] = s;
  }
  Table<Index> first_child(count, -1);
  Table<Index> next_sibling(count, -1);
  Table<Index> last_seen(pattern.size(), -1);
  nodes.row_start.assign(Offset{count} + 1, 0);
  for (Index s = 0; s < count; ++s) {
    const Index end = nodes.first_column[Offset{s} + 1];
    const Offset begin_rows = nodes.rows.size();
    const auto add = [&](Index row) {
      if (row < end || last_seen[row] == s) return;
      last_seen[row] = s;
      nodes.rows.push_back(row);
    };
    for (Index column = nodes.first_column[s]; column < end; ++column) {
      for (const Index row : pattern.rows(column).subspan(1)) add(row);
    }
    for (Index child = first_child[s]; child != -1; child = next_sibling[child]) {
      for (Offset k = nodes.row_start[child]; k < nodes.row_start[Offset{child} + 1]; ++k) add(nodes.rows[k]);
    }
    std::sort(nodes.rows.begin() + begin_rows, nodes.rows.end());
    nodes.row_start[Offset{s} + 1] = nodes.rows.size();
    const Index column_parent = column_parents[static_cast<std::size_t>(end - 1)];
    nodes.parent[s] = column_parent == -1 ? -1 : supernode_of[column_parent];
    if (nodes.parent[s] == -1) continue;
    next_sibling[s] = first_child[nodes.parent[s]];
    first_child[nodes.parent[s]] = s;
    ++nodes.child_count[nodes.parent[s]];
  }
}

/// Finds each row's place in the parent's front, and the parity of each supernode's level.
inline void link_to_parents(Supernodes& nodes) {
  nodes.row_in_parent.resize(nodes.rows.size());
  for (Index s = nodes.size() - 1; s >= 0; --s) {
    const Index parent = nodes.parent[s];
    if (parent == -1) continue;
    nodes.odd_level[s] = nodes.odd_level[parent] == 0 ? 1 : 0;
    const std::span<const Index> parent_rows = nodes.rows_of(parent);
    const Index first = nodes.first_column[parent];
    const Index columns = nodes.columns(parent);
    std::size_t next = 0;
    for (Offset k = nodes.row_start[s]; k < nodes.row_start[Offset{s} + 1]; ++k) {
      const Index row = nodes.rows[k];
      if (row < first + columns) {
        nodes.row_in_parent[k] = row - first;
        continue;
      }
      while (parent_rows[next] != row) ++next;
      nodes.row_in_parent[k] = columns + static_cast<Index>(next);
    }
  }
}

/// The supernodes of a pattern whose columns are to be eliminated in `order`, but for a postorder of the tree, which
/// changes no fill.
[[nodiscard]] inline Supernodes find_supernodes(const BlockPattern& pattern, std::vector<Index> order, int block_size) {
  Supernodes nodes;
  nodes.order = Table<Index>(std::span<const Index>(order));
  {
    const BlockPattern ordered = permuted(pattern, inverse_permutation(nodes.order));
    const std::vector<Index> parents = elimination_tree(ordered);
    Table<Index> visited;
    for (const Index k : postorder(parents, factor_column_counts(ordered, parents))) visited.push_back(nodes.order[k]);
    nodes.order = std::move(visited);
  }
  nodes.position = inverse_permutation(nodes.order);
  const BlockPattern ordered = permuted(pattern, nodes.position);
  const std::vector<Index> parents = elimination_tree(ordered);
  const std::vector<Index> counts = factor_column_counts(ordered, parents);
  nodes.first_column = SupernodeJoiner(parents, counts, block_size).join();
  const Offset count = nodes.first_column.size() - 1;
  nodes.parent.assign(count, -1);
  nodes.child_count.assign(count, 0);
  nodes.odd_level.assign(count, 0);
  find_rows(ordered, parents, nodes);
  link_to_parents(nodes);
  return nodes;
}

}  // namespace chainslam::detail
