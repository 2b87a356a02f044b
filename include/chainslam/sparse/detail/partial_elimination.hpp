#pragma once

#include <algorithm>
#include <span>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/block_matrix.hpp"
#include "chainslam/sparse/detail/front.hpp"
#include "chainslam/sparse/detail/quotient_graph.hpp"

namespace chainslam::detail {

/// Plans how some columns of a matrix are eliminated after all others: their order, and the fronts in which they are
/// factorized together.
///
/// Columns are numbered from 0; those before have left elements (cliques of columns) behind. Memory is kept for the
/// next plan. Fronts come in the order of their elimination, children before parents.
class PartialElimination {
 public:
  struct Front {
    Offset first_column;  ///< in `columns()`
    Index columns;
    Offset first_row;  ///< in `rows()`
    Index rows;
    Index parent;  ///< -1 at a root
  };

  /// Starts a new plan for `size` columns.
  void begin(Index size) {
    size_ = size;
    edges_.clear();
    element_columns_.clear();
    element_ends_.clear();
  }
  void add_edge(Index a, Index b) { edges_.push_back({a, b}); }
  /// Adds a column to the element that is being listed.
  void add_to_element(Index column) { element_columns_.push_back(column); }
  void end_element() { element_ends_.push_back(element_columns_.size()); }

  /// @param late        ascending: columns from each of these on are eliminated after all before it.
  /// @param block_size  scalar columns of a column.
  void plan(std::span<const Index> late, int block_size) {
    late_ = late;
    list_elements();
    const BlockPattern pattern(size_, edges_.all());
    order_ = QuotientGraph(pattern, elements_.all(), late).eliminate();
    position_.resize(size_);
    for (Index k = 0; k < size_; ++k) position_[order_[k]] = k;
    list_edges(pattern);
    find_rows(block_size);
    list_fronts();
  }

  /// Multiplications of its fronts.
  template <int B>
  [[nodiscard]] double work() const {
    double sum = 0.0;
    for (const Front& front : fronts_) sum += detail::Front<B>::work(front.columns, front.rows);
    return sum;
  }
  [[nodiscard]] Index fronts() const { return to_index(fronts_.size()); }
  [[nodiscard]] const Front& front(Index f) const { return fronts_[f]; }
  [[nodiscard]] std::span<const Index> columns(const Front& front) const {
    return columns_.range(front.first_column, front.first_column + front.columns);
  }
  /// Columns of later fronts, in the order of their elimination.
  [[nodiscard]] std::span<const Index> rows(const Front& front) const {
    return rows_.range(front.first_row, front.first_row + front.rows);
  }
  /// The front that takes an element, by the order in which they were added.
  [[nodiscard]] Index front_of_element(Index e) const { return front_of_[element_first_[e]]; }

 private:
  void list_elements() {
    elements_.clear();
    Offset begin = 0;
    for (const Offset end : element_ends_) {
      elements_.push_back(element_columns_.range(begin, end));
      begin = end;
    }
  }

  /// Edges by the position of the end that is eliminated first; elements by their first column's.
  void list_edges(const BlockPattern& pattern) {
    const auto for_each = [&](auto&& visit) {
      for (Index column = 0; column < size_; ++column) {
        for (const Index row : pattern.rows(column).subspan(1))
          visit(std::min(position_[row], position_[column]), std::max(position_[row], position_[column]));
      }
    };
    edge_start_.assign(Offset{size_} + 1, 0);
    for_each([&](Index first, Index) { ++edge_start_[Offset{first} + 1]; });
    for (Index k = 0; k < size_; ++k) edge_start_[Offset{k} + 1] += edge_start_[k];
    edge_rows_.resize(edge_start_[size_]);
    next_.assign(size_, 0);
    for_each([&](Index first, Index second) { edge_rows_[edge_start_[first] + next_[first]++] = second; });

    first_element_.assign(size_, -1);
    next_element_.resize(to_index(elements_.size()));
    element_first_.resize(to_index(elements_.size()));
    for (Index e = 0; e < to_index(elements_.size()); ++e) {
      Index first = size_;
      for (const Index column : elements_[e]) first = std::min(first, position_[column]);
      element_first_[e] = first;
      next_element_[e] = first_element_[first];
      first_element_[first] = e;
    }
  }

  /// Rows of each column, as positions; columns that are worth it join their parents.
  void find_rows(int block_size) {
    found_.clear();
    found_start_.resize(Offset{size_} + 1);
    first_child_.assign(size_, -1);
    next_.assign(size_, -1);
    seen_.assign(size_, -1);
    joined_.assign(size_, -1);
    count_.assign(size_, 1);
    zeros_.assign(size_, 0);
    parent_.assign(size_, -1);
    for (Index k = 0; k < size_; ++k) {
      found_start_[k] = found_.size();
      Index least = size_;
      const auto add = [&](Index row) {
        if (row <= k || seen_[row] == k) return;
        seen_[row] = k;
        least = std::min(least, row);
        found_.push_back(row);
      };
      for (Offset e = edge_start_[k]; e < edge_start_[Offset{k} + 1]; ++e) add(edge_rows_[e]);
      for (Index e = first_element_[k]; e != -1; e = next_element_[e]) {
        for (const Index column : elements_[e]) add(position_[column]);
      }
      for (Index child = first_child_[k]; child != -1; child = next_[child]) {
        for (Offset r = found_start_[child]; r < found_start_[Offset{child} + 1]; ++r) add(found_[r]);
      }
      found_start_[Offset{k} + 1] = found_.size();
      join_children(k, block_size);
      if (least == size_) continue;
      parent_[k] = least;
      next_[k] = first_child_[least];
      first_child_[least] = k;
    }
  }

  [[nodiscard]] Index row_count(Index k) const { return to_index(found_start_[Offset{k} + 1] - found_start_[k]); }

  /// As in `SupernodeJoiner`, but any child may join; and large fronts are left apart, so that changes of the columns
  /// eliminated last, as the next ones mostly are, do not reach all.
  void join_children(Index k, int block_size) {
    for (Index child = first_child_[k]; child != -1; child = next_[child]) {
      const Offset below = count_[k] + row_count(k);
      const Offset columns = count_[k] + count_[child];
      if (columns * block_size > most_joined) continue;
      if (count_[child] * block_size > most_joined_late && group_of(late_, order_[child]) < group_of(late_, order_[k]))
        continue;
      const Offset zeros = zeros_[k] + zeros_[child] + count_[child] * (below - row_count(child));
      const Offset height = columns + row_count(k);
      const double share =
          static_cast<double>(zeros) / static_cast<double>(columns * height - columns * (columns - 1) / 2);
      const Offset scalar_columns = columns * block_size;
      if (zeros > 0 && !(scalar_columns <= 12 && share < 0.3) && !(scalar_columns <= 48 && share < 0.1) &&
          share >= 0.03)
        continue;
      joined_[child] = k;
      count_[k] += count_[child];
      zeros_[k] = zeros;
    }
  }

  void list_fronts() {
    fronts_.clear();
    rows_.clear();
    front_of_.resize(size_);
    Offset first_column = 0;
    for (Index k = 0; k < size_; ++k) {
      if (joined_[k] != -1) continue;
      front_of_[k] = to_index(fronts_.size());
      const Offset first_row = rows_.size();
      for (Offset r = found_start_[k]; r < found_start_[Offset{k} + 1]; ++r) rows_.push_back(found_[r]);
      std::sort(rows_.begin() + first_row, rows_.end());
      fronts_.push_back({first_column, count_[k], first_row, to_index(rows_.size() - first_row), parent_[k]});
      first_column += count_[k];
    }
    for (Index k = size_ - 1; k >= 0; --k) {
      if (joined_[k] != -1) front_of_[k] = front_of_[joined_[k]];
    }
    for (Front& front : fronts_) {
      if (front.parent != -1) front.parent = front_of_[front.parent];
    }
    for (Index& row : rows_) row = order_[row];
    columns_.resize(size_);
    next_.assign(to_index(fronts_.size()), 0);
    for (Index k = 0; k < size_; ++k) columns_[fronts_[front_of_[k]].first_column + next_[front_of_[k]]++] = order_[k];
  }

  static constexpr Offset most_joined = 144;      ///< scalar columns of a front that joins of others
  static constexpr Offset most_joined_late = 48;  ///< that a front brings which joins one of later columns

  Index size_ = 0;
  std::span<const Index> late_;
  Table<BlockCoordinate> edges_;
  Table<Index> element_columns_;
  Table<Offset> element_ends_;
  Table<std::span<const Index>> elements_;
  Table<Index> order_;
  Table<Index> position_;
  Table<Offset> edge_start_;
  Table<Index> edge_rows_;
  Table<Index> first_element_;
  Table<Index> next_element_;
  Table<Index> element_first_;  ///< position of the column that is eliminated first
  Table<Index> found_;
  Table<Offset> found_start_;
  Table<Index> first_child_;
  Table<Index> next_;
  Table<Index> seen_;
  Table<Index> joined_;  ///< the column that a column joined, its parent
  Table<Index> count_;
  Table<Offset> zeros_;
  Table<Index> parent_;
  Table<Index> front_of_;
  Table<Front> fronts_;
  Table<Index> columns_;
  Table<Index> rows_;
};

}  // namespace chainslam::detail
