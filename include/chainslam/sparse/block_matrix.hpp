#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <optional>
#include <span>
#include <stdexcept>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"

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
