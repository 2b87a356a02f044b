#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstdint>
#include <optional>
#include <span>
#include <stdexcept>
#include <vector>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/detail/arena.hpp"

namespace chainslam {

/// Row and column of a block.
struct BlockCoordinate {
  Index row = 0;     ///< block row
  Index column = 0;  ///< block column
};

/// Where a symmetric matrix of n x n blocks is not zero: its lower triangle, by columns, rows ascending. Every diagonal
/// block belongs to it and is the first of its column.
class BlockPattern {
 public:
  BlockPattern() = default;

  /// Linear in `size` and the number of blocks.
  ///
  /// @param size    number of block columns.
  /// @param blocks  blocks of either triangle, in any order; repetitions and diagonal blocks are allowed.
  /// @throws std::invalid_argument if a block lies outside.
  BlockPattern(Index size, std::span<const BlockCoordinate> blocks) : size_(size), starts_(Offset{size} + 1, 0) {
    if (size < 0) throw std::invalid_argument("BlockPattern: size must not be negative");
    for (const BlockCoordinate& block : blocks) {
      if (std::min(block.row, block.column) < 0 || std::max(block.row, block.column) >= size)
        throw std::invalid_argument("BlockPattern: a block lies outside the matrix");
    }
    fill_columns(columns_by_row(blocks));
  }

  [[nodiscard]] Index size() const { return size_; }  ///< number of block rows and columns
  /// Number of blocks in the lower triangle, diagonal included.
  [[nodiscard]] Offset blocks() const { return rows_.size(); }
  /// Position of a column's diagonal block; its other blocks follow.
  [[nodiscard]] Offset begin(Index column) const { return starts_[column]; }
  /// Behind the last position of a column.
  [[nodiscard]] Offset end(Index column) const { return starts_[Offset{column} + 1]; }
  [[nodiscard]] Index row(Offset position) const { return rows_[position]; }  ///< block row of a position
  /// Block rows of a column, ascending.
  [[nodiscard]] std::span<const Index> rows(Index column) const { return rows_.range(begin(column), end(column)); }

  /// Position of block (row, column) of the lower triangle, row >= column. O(log rows in the column).
  [[nodiscard]] std::optional<Offset> find(Index row, Index column) const {
    const std::span<const Index> in_column = rows(column);
    const auto found = std::lower_bound(in_column.begin(), in_column.end(), row);
    if (found == in_column.end() || *found != row) return std::nullopt;
    return begin(column) + (found - in_column.begin());
  }

 private:
  struct RowLists {
    detail::Table<Offset> starts;
    detail::Table<Index> columns;
  };

  /// Bucket sort by row: afterwards one pass over the rows visits each column's blocks in ascending order.
  [[nodiscard]] RowLists columns_by_row(std::span<const BlockCoordinate> blocks) const {
    RowLists lists{detail::Table<Offset>(Offset{size_} + 1, 0), {}};
    for (const BlockCoordinate& block : blocks) ++lists.starts[Offset{std::max(block.row, block.column)} + 1];
    for (Index row = 0; row < size_; ++row) lists.starts[Offset{row} + 1] += lists.starts[row];
    lists.columns.resize(lists.starts[size_]);
    detail::Table<Offset> next = lists.starts;
    for (const BlockCoordinate& block : blocks)
      lists.columns[next[std::max(block.row, block.column)]++] = std::min(block.row, block.column);
    return lists;
  }

  void fill_columns(const RowLists& lists) {
    const auto for_each_once = [&](auto&& visit) {
      detail::Table<Index> last_row(size_, -1);
      for (Index row = 0; row < size_; ++row) {
        last_row[row] = row;
        visit(row, row);
        for (Offset k = lists.starts[row]; k < lists.starts[Offset{row} + 1]; ++k) {
          const Index column = lists.columns[k];
          if (last_row[column] == row) continue;
          last_row[column] = row;
          visit(row, column);
        }
      }
    };
    for_each_once([&](Index, Index column) { ++starts_[Offset{column} + 1]; });
    for (Index column = 0; column < size_; ++column) starts_[Offset{column} + 1] += starts_[column];
    rows_.resize(starts_[size_]);
    detail::Table<Offset> next = starts_;
    for_each_once([&](Index row, Index column) { rows_[next[column]++] = row; });
  }

  Index size_ = 0;
  detail::Table<Offset> starts_ = detail::Table<Offset>(1, 0);
  detail::Table<Index> rows_;
};

/// Symmetric matrix of `BlockSize` x `BlockSize` blocks on a fixed pattern: made once, refilled often, no allocation
/// then.
///
/// Blocks are plain column-major arrays in the pattern's order, so that no compiler flag changes their layout. Of the
/// diagonal blocks the lower triangle counts.
template <int BlockSize>
class BlockMatrix {
  static_assert(BlockSize > 0, "BlockMatrix: BlockSize is a number of scalar rows, at least 1");

 public:
  static constexpr int block_size = BlockSize;                ///< rows and columns of a block
  using Block = Eigen::Matrix<double, BlockSize, BlockSize>;  ///< a block, column by column
  using Vector = Eigen::VectorXd;                             ///< as many numbers as the matrix has rows

  BlockMatrix() = default;
  /// All blocks zero.
  explicit BlockMatrix(BlockPattern pattern)
      : pattern_(std::move(pattern)), values_(pattern_.blocks() * BlockSize * BlockSize, 0.0) {}

  [[nodiscard]] const BlockPattern& pattern() const { return pattern_; }  ///< where blocks may be
  [[nodiscard]] Index size() const { return pattern_.size(); }            ///< number of block rows and columns

  void set_zero() { std::fill(values_.begin(), values_.end(), 0.0); }  ///< sets all blocks to zero

  /// Block at a position of the pattern.
  [[nodiscard]] Eigen::Map<Block> block(Offset position) { return Eigen::Map<Block>(data(position)); }
  /// The block at a position.
  [[nodiscard]] Eigen::Map<const Block> block(Offset position) const { return Eigen::Map<const Block>(data(position)); }
  /// The numbers of the block at a position, column by column.
  [[nodiscard]] double* data(Offset position) { return values_.data() + position * BlockSize * BlockSize; }
  /// The numbers of the block at a position, column by column.
  [[nodiscard]] const double* data(Offset position) const { return values_.data() + position * BlockSize * BlockSize; }

  /// The matrix times x; both triangles, `size() * BlockSize` rows.
  [[nodiscard]] Vector operator*(const Vector& x) const {
    Vector y = Vector::Zero(Eigen::Index{size()} * BlockSize);
    for (Index column = 0; column < size(); ++column) {
      const Eigen::Index j = Eigen::Index{column} * BlockSize;
      y.segment<BlockSize>(j).noalias() +=
          block(pattern_.begin(column)).template selfadjointView<Eigen::Lower>() * x.segment<BlockSize>(j);
      for (Offset k = pattern_.begin(column) + 1; k < pattern_.end(column); ++k) {
        const Eigen::Index i = Eigen::Index{pattern_.row(k)} * BlockSize;
        y.segment<BlockSize>(i).noalias() += block(k) * x.segment<BlockSize>(j);
        y.segment<BlockSize>(j).noalias() += block(k).transpose() * x.segment<BlockSize>(i);
      }
    }
    return y;
  }

 private:
  BlockPattern pattern_;
  detail::Table<double> values_;
};

}  // namespace chainslam

namespace chainslam::detail {

/// The terms J^T J and J^T r whose sums are a matrix and a gradient, each on a few block variables.
///
/// Of each term the transposed Jacobian is kept, column-major with a column for each residual row, and the residual.
/// Each variable has a list of its terms. A term may be taken out of the lists and put back: if that is done in the
/// opposite order, the lists are as they were.
template <int B>
class BlockTerms {
 public:
  struct Slot {
    Index variable;
    Index term;
    Index next;  ///< in the list of the variable; -1 at its end
    Index previous;
  };

  void add_variable() { first_.push_back(-1); }
  void drop_last_variable() { first_.pop_back(); }

  /// @returns the new term, linked; its numbers are zero.
  Index add(std::span<const Index> variables, Index rows) {
    const Index arity = to_index(variables.size());
    const Index term = take(arity);
    Term& added = terms_[term];
    added.rows = rows;
    added.counted = false;
    added.data = arena_.take(size(term));
    std::fill_n(added.data, size(term), 0.0);
    for (Index k = 0; k < arity; ++k) slots_[added.first_slot + k].variable = variables[static_cast<std::size_t>(k)];
    link(term);
    return term;
  }

  /// Gives a term's memory and number back; it must not be linked.
  void release(Index term) {
    Term& released = terms_[term];
    arena_.give_back(released.data, size(term));
    released.data = nullptr;
    if (released.arity >= to_index(free_.size())) free_.resize(static_cast<std::size_t>(released.arity) + 1);
    free_[static_cast<std::size_t>(released.arity)].push_back(term);
  }

  void link(Index term) {
    terms_[term].linked = true;
    for (Offset k = terms_[term].first_slot; k < end_slot(term); ++k) {
      Slot& slot = slots_[k];
      slot.previous = -1;
      slot.next = first_[slot.variable];
      if (slot.next != -1) slots_[slot.next].previous = static_cast<Index>(k);
      first_[slot.variable] = static_cast<Index>(k);
    }
  }
  void unlink(Index term) {
    terms_[term].linked = false;
    for (Offset k = terms_[term].first_slot; k < end_slot(term); ++k) {
      const Slot& slot = slots_[k];
      (slot.previous == -1 ? first_[slot.variable] : slots_[slot.previous].next) = slot.next;
      if (slot.next != -1) slots_[slot.next].previous = slot.previous;
    }
  }
  /// Undoes the last `unlink` that was not yet undone.
  void relink(Index term) {
    terms_[term].linked = true;
    for (Offset k = end_slot(term) - 1; k >= terms_[term].first_slot; --k) {
      const Slot& slot = slots_[k];
      (slot.previous == -1 ? first_[slot.variable] : slots_[slot.previous].next) = static_cast<Index>(k);
      if (slot.next != -1) slots_[slot.next].previous = static_cast<Index>(k);
    }
  }

  /// @param released  terms that are taken as if they had been released, in this order.
  void save(ByteSink& out, std::span<const Index> released) const {
    out.put_list(first_);
    out.put(static_cast<std::uint64_t>(terms_.size()));
    for (Index term = 0; term < count(); ++term) {
      out.put(arity(term));
      out.put(linked(term) ? rows(term) : Index{-1});
      for (const Slot& slot : slots(term)) {
        for (const Index index : {slot.variable, slot.next, slot.previous}) out.put(index);
      }
      if (!linked(term)) continue;
      out.put(static_cast<std::uint8_t>(counted(term)));
      for (Offset k = 0; k < size(term); ++k) out.put(jacobian(term)[k]);
    }
    std::vector<std::vector<Index>> unused = free_;
    for (const Index term : released) {
      if (arity(term) >= to_index(unused.size())) unused.resize(static_cast<std::size_t>(arity(term)) + 1);
      unused[static_cast<std::size_t>(arity(term))].push_back(term);
    }
    out.put(static_cast<std::uint64_t>(unused.size()));
    for (const std::vector<Index>& terms : unused) out.put_list(terms);
  }
  /// What `save` wrote, into an empty list of terms.
  void load(ByteSource& in) {
    in.take_list(first_);
    const auto count = in.take<std::uint64_t>();
    for (std::uint64_t term = 0; term < count; ++term) {
      Term added{nullptr, to_index(slots_.size()), in.take<Index>(), in.take<Index>(), false, false};
      for (Index k = 0; k < added.arity; ++k) {
        const auto variable = in.take<Index>();
        const auto next = in.take<Index>();
        slots_.push_back({variable, static_cast<Index>(term), next, in.take<Index>()});
      }
      terms_.push_back(added);
      if (added.rows < 0) continue;
      Term& linked = terms_.back();
      linked.linked = true;
      linked.counted = in.take<std::uint8_t>() != 0;
      linked.data = arena_.take(size(static_cast<Index>(term)));
      for (Offset k = 0; k < size(static_cast<Index>(term)); ++k) linked.data[k] = in.take<double>();
    }
    free_.resize(in.take<std::uint64_t>());
    for (std::vector<Index>& terms : free_) in.take_list(terms);
  }

  /// Terms, be they in use or not.
  [[nodiscard]] Index count() const { return to_index(terms_.size()); }

  [[nodiscard]] bool linked(Index term) const { return terms_[term].linked; }
  /// A mark for the owner: whether the term's squared residual is part of a sum.
  [[nodiscard]] bool counted(Index term) const { return terms_[term].counted; }
  void set_counted(Index term, bool counted) { terms_[term].counted = counted; }
  [[nodiscard]] Index arity(Index term) const { return terms_[term].arity; }
  [[nodiscard]] Index rows(Index term) const { return terms_[term].rows; }
  [[nodiscard]] std::span<const Slot> slots(Index term) const {
    return slots_.range(terms_[term].first_slot, end_slot(term));
  }
  /// Head of a variable's list, -1 if it has no term.
  [[nodiscard]] Index first(Index variable) const { return first_[variable]; }
  [[nodiscard]] const Slot& slot(Index k) const { return slots_[k]; }

  /// Numbers of Jacobian and residual.
  [[nodiscard]] Offset size(Index term) const { return (Offset{arity(term)} * B + 1) * rows(term); }
  /// J^T: `arity * B` rows, a column for each residual row.
  [[nodiscard]] double* jacobian(Index term) const { return terms_[term].data; }
  /// r, behind the Jacobian.
  [[nodiscard]] double* residual(Index term) const { return terms_[term].data + Offset{arity(term)} * B * rows(term); }
  [[nodiscard]] double squared_residual(Index term) const {
    double sum = 0.0;
    for (Index row = 0; row < rows(term); ++row) sum += residual(term)[row] * residual(term)[row];
    return sum;
  }

 private:
  struct Term {
    double* data = nullptr;
    Index first_slot = 0;
    Index arity = 0;
    Index rows = 0;
    bool linked = false;
    bool counted = false;
  };

  [[nodiscard]] Offset end_slot(Index term) const { return Offset{terms_[term].first_slot} + terms_[term].arity; }

  /// An unused term of this arity.
  [[nodiscard]] Index take(Index arity) {
    if (arity < to_index(free_.size()) && !free_[static_cast<std::size_t>(arity)].empty()) {
      std::vector<Index>& unused = free_[static_cast<std::size_t>(arity)];
      const Index term = unused.back();
      unused.pop_back();
      return term;
    }
    const Index term = to_index(terms_.size(), "number of factors");
    terms_.push_back({nullptr, to_index(slots_.size(), "number of factors' variables"), arity, 0, false, false});
    for (Index k = 0; k < arity; ++k) slots_.push_back({-1, term, -1, -1});
    return term;
  }

  Table<Index> first_;  ///< of each variable
  Table<Term> terms_;
  Table<Slot> slots_;
  std::vector<std::vector<Index>> free_;  ///< unused terms of each arity
  Arena<double> arena_;
};

}  // namespace chainslam::detail
