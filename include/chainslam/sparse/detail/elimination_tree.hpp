#pragma once

#include <algorithm>
#include <span>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/block_matrix.hpp"

namespace chainslam::detail {

/// The elimination tree of a symmetric pattern: the parent of column j is the first row below the diagonal in column j
/// of the Cholesky factor, -1 at a root. Near-linear, no recursion. Liu 1986, "A compact row storage scheme for
/// Cholesky factors using elimination trees", with path compression.
[[nodiscard]] inline std::vector<Index> elimination_tree(const BlockPattern& pattern);

/// Number of blocks in each column of the Cholesky factor, diagonal included. Linear in their sum, no recursion.
[[nodiscard]] inline std::vector<Index> factor_column_counts(const BlockPattern& pattern,
                                                             std::span<const Index> parents);

/// Visits children before parents: entry k is the k-th column visited. A column's children come in ascending order of
/// `weights` (of their number where equal), so that the heaviest child is visited just before its parent. No recursion.
[[nodiscard]] inline std::vector<Index> postorder(std::span<const Index> parents, std::span<const Index> weights);

/// The strictly lower triangle by rows: the columns of each row, ascending.
struct RowPattern {
  Table<Offset> starts;
  Table<Index> columns;

  explicit RowPattern(const BlockPattern& pattern)
      : starts(Offset{pattern.size()} + 1, 0), columns(pattern.blocks() - pattern.size()) {
    const Index size = pattern.size();
    for (Index column = 0; column < size; ++column) {
      for (const Index row : pattern.rows(column).subspan(1)) ++starts[Offset{row} + 1];
    }
    for (Index row = 0; row < size; ++row) starts[Offset{row} + 1] += starts[row];
    Table<Offset> next = starts;
    for (Index column = 0; column < size; ++column) {
      for (const Index row : pattern.rows(column).subspan(1)) columns[next[row]++] = column;
    }
  }

  [[nodiscard]] std::span<const Index> operator[](Index row) const {
    return columns.range(starts[row], starts[Offset{row} + 1]);
  }
};

inline std::vector<Index> elimination_tree(const BlockPattern& pattern) {
  const Index size = pattern.size();
  const detail::RowPattern by_row(pattern);
  detail::Table<Index> parent(size, -1);
  detail::Table<Index> ancestor(size, -1);
  for (Index row = 0; row < size; ++row) {
    for (Index column : by_row[row]) {
      while (column != -1 && column != row) {
        const Index above = ancestor[column];
        ancestor[column] = row;
        if (above == -1) parent[column] = row;
        column = above;
      }
    }
  }
  return {parent.begin(), parent.end()};
}

inline std::vector<Index> factor_column_counts(const BlockPattern& pattern, std::span<const Index> parents) {
  const Index size = pattern.size();
  const detail::RowPattern by_row(pattern);
  detail::Table<Index> counts(size, 1);
  detail::Table<Index> last_row(size, -1);
  for (Index row = 0; row < size; ++row) {
    last_row[row] = row;
    for (Index column : by_row[row]) {
      for (; last_row[column] != row; column = parents[static_cast<std::size_t>(column)]) {
        ++counts[column];
        last_row[column] = row;
      }
    }
  }
  return {counts.begin(), counts.end()};
}

inline std::vector<Index> postorder(std::span<const Index> parents, std::span<const Index> weights) {
  const Index size = to_index(parents.size());
  std::vector<Index> heaviest_first(parents.size());
  for (Index column = 0; column < size; ++column) heaviest_first[static_cast<std::size_t>(column)] = column;
  std::sort(heaviest_first.begin(), heaviest_first.end(), [&](Index a, Index b) {
    const Index weight_a = weights[static_cast<std::size_t>(a)];
    const Index weight_b = weights[static_cast<std::size_t>(b)];
    return weight_a != weight_b ? weight_a > weight_b : a > b;
  });
  // Pushing the heaviest first leaves the lightest at the head of each parent's list; slot `size` holds the roots.
  detail::Table<Index> first_child(Offset{size} + 1, -1);
  detail::Table<Index> next_sibling(size, -1);
  for (const Index column : heaviest_first) {
    const Index parent = parents[static_cast<std::size_t>(column)];
    Index& head = first_child[parent == -1 ? size : parent];
    next_sibling[column] = head;
    head = column;
  }
  std::vector<Index> order;
  order.reserve(parents.size());
  Index column = first_child[size];
  while (column != -1) {
    while (first_child[column] != -1) column = first_child[column];
    order.push_back(column);
    while (next_sibling[column] == -1) {
      column = parents[static_cast<std::size_t>(column)];
      if (column == -1) return order;
      order.push_back(column);
    }
    column = next_sibling[column];
  }
  return order;
}

}  // namespace chainslam::detail
