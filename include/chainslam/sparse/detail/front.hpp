#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <span>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/dense_kernels.hpp"
#include "chainslam/sparse/detail/panel.hpp"

namespace chainslam::detail {

/// The numbers of one front of a multifrontal factorization, in two arrays: its columns of the factor and their part of
/// the right-hand side, which stay, and what is there while it is computed and for the parent (the update).
///
/// A front has `columns` block columns of its own and `rows` block rows below them. The panel holds its columns,
/// column-major, all rows. The update is a lower triangle by block columns, each with the rows from its diagonal on.
template <int B>
class Front {
 public:
  /// @param update  null where it is not kept: the front is then as it was computed, and cannot be computed anew.
  Front(double* data, double* update, Index columns, Index rows)
      : data_(data), update_(update), columns_(columns), rows_(rows) {}

  /// Numbers that stay.
  [[nodiscard]] static Offset size(Index columns, Index rows) {
    return (Offset{columns} * 2 + (is_large(columns, rows) ? Offset{rows} : 0)) * B + panel_size(columns, rows);
  }
  /// Whether it has `row_norms`: substitution costs much more then than to use them.
  [[nodiscard]] static bool is_large(Index columns, Index rows) {
    constexpr Offset least = 3000;
    return panel_size(columns, rows) >= least;
  }
  /// Numbers of the update.
  [[nodiscard]] static Offset update_size(Index columns, Index rows) {
    return update_start(columns, rows) + Offset{rows} * (Offset{rows} + 1) / 2 * B * B;
  }
  /// Multiplications of a factorization.
  [[nodiscard]] static double work(Index columns, Index rows) {
    const double n = columns * B, m = rows * B;
    return n * n * n / 6 + n * n * m / 2 + n * m * m / 2;
  }

  [[nodiscard]] Index columns() const { return columns_; }
  [[nodiscard]] Index rows() const { return rows_; }
  [[nodiscard]] Index height() const { return columns_ + rows_; }
  /// Distance between the columns of the panel.
  [[nodiscard]] Offset stride() const { return Offset{height()} * B; }

  /// Minus the gradient of all that is eliminated here and of the rows, the own part as it is before elimination.
  [[nodiscard]] double* right() const { return update_; }
  /// Its own part as back-substitution needs it, after `substitute_forward`.
  [[nodiscard]] double* own_right() const { return panel() + Offset{columns_} * B * stride(); }
  /// Of the factor's diagonal, after elimination.
  [[nodiscard]] double* reciprocals() const { return data_; }
  /// Diagonal of the matrix before any elimination, as far as it is known here. Of own columns: before elimination.
  [[nodiscard]] double* scale(Index row) const {
    return row < columns_ ? data_ + Offset{row} * B : row_scales() + Offset{row - columns_} * B;
  }
  [[nodiscard]] double* panel() const { return data_ + Offset{columns_} * B; }

  /// Euclidean norms of the factor's rows below the own columns, of a large front. Computed when they are first asked
  /// for: `set_zero`, with which each computation of a front begins, leaves zeros.
  [[nodiscard]] const double* row_norms() const {
    const Offset rows = Offset{rows_} * B;
    double* const norms = panel() + panel_size(columns_, rows_) + Offset{columns_} * B;
    if (rows == 0 || norms[0] != 0.0) return norms;
    std::fill_n(norms, rows, 0.0);  // a first row of zeros brings us here again
    for (Offset column = 0; column < Offset{columns_} * B; ++column) {
      const double* const below = panel() + column * stride() + Offset{columns_} * B;
      for (Offset row = 0; row < rows; ++row) norms[row] += below[row] * below[row];
    }
    for (Offset row = 0; row < rows; ++row) norms[row] = std::sqrt(norms[row]);
    return norms;
  }

  void set_zero() const {
    std::fill_n(data_, size(columns_, rows_), 0.0);
    std::fill_n(update_, update_size(columns_, rows_), 0.0);
  }

  /// Fetches its first numbers, all of most fronts, into the cache.
  void prefetch() const {
    constexpr Offset line = 64 / sizeof(double), most = 512;
    for (Offset k = 0; k < std::min(size(columns_, rows_), most); k += line) __builtin_prefetch(data_ + k);
  }

  struct Block {
    double* data;
    Offset stride;
  };
  /// Block (row, column) of the front, row >= column, own columns first.
  [[nodiscard]] Block block(Index row, Index column) const {
    if (column < columns_) return {panel() + Offset{column} * B * stride() + Offset{row} * B, stride()};
    const Index j = column - columns_;
    return {update(j) + Offset{row - column} * B, update_stride(j)};
  }

  /// Factorizes the own columns and subtracts them from the update, whose columns are shared out by an executor.
  /// @returns the own column with a bad pivot, or -1.
  template <Executor Exec = Serial>
  [[nodiscard]] Index eliminate(double pivot_tolerance, const Exec& executor = {}) const {
    const Index bad = own().eliminate(reciprocals(), pivot_tolerance);
    if (bad != -1) return bad;
    executor.for_chunks(rows_, 4, [&](Index begin, Index end) {
      for (Index j = begin; j < end; ++j) own().subtract_from_update(j, update(j), update_stride(j));
    });
    return -1;
  }

  /// Applies the factor's inverse to the own part of a right-hand side and subtracts it from the rest.
  void substitute_forward(double* right_side) const { own().substitute_forward(right_side); }
  /// The same for N of them: see `Panel`.
  template <int N>
  void substitute_forward(double* right_sides, double* solved) const {
    own().template substitute_forward<N>(right_sides, stride(), solved);
  }
  void substitute_forward() const {
    own().substitute_forward(right());
    std::copy_n(right(), Offset{columns_} * B, own_right());
  }

  /// Turns the own part of `x` into the solution, given the rows' behind it.
  void substitute_backward(double* x) const { own().substitute_backward(x, rows_); }
  /// First half of that: subtracts what the rows' solution, behind the own part of `x`, takes.
  void subtract_rows(double* x) const {
    for (Index j = 0; j < columns_ && rows_ > 0; ++j) {
      subtract_dots<B>(Offset{rows_} * B, panel() + Offset{j} * B * stride() + Offset{columns_} * B, stride(),
                       x + Offset{columns_} * B, x + Offset{j} * B);
    }
  }
  /// Second half: turns the own part of `x` into the solution.
  void solve_columns(double* solution) const { own().substitute_backward(solution, 0); }
  /// What the squared error of the whole system exceeds its minimum by if the own part is `x` instead of the solution,
  /// given `right` after `subtract_rows`.
  [[nodiscard]] double excess(const double* right_side, const double* x) const {
    double sum = 0.0;
    for (Index j = 0; j < columns_; ++j, right_side += B, x += B) {
      const double* const diagonal = panel() + Offset{j} * B * (stride() + 1);
      std::array<double, B> rest;
      std::copy_n(right_side, B, rest.data());
      subtract_dots<B>(Offset{columns_ - j - 1} * B, diagonal + B, stride(), x + B, rest.data());
      for (int c = 0; c < B; ++c) {
        double& of_column = rest[static_cast<std::size_t>(c)];
        for (int r = c; r < B; ++r) of_column -= diagonal[c * stride() + r] * x[r];
        sum += of_column * of_column;
      }
    }
    return sum;
  }

  /// Adds what a child leaves (extend-add). `place[k]` is the child's row k in this front.
  void add_child(const Front& child, std::span<const Index> place) const {
    add_update(child, place);
    const double* from_right = child.right() + Offset{child.columns()} * B;
    const double* from_scale = child.row_scales();
    for (const Index row : place) {
      double* const to_right = right() + Offset{row} * B;
      double* const to_scale = scale(row);
      for (int k = 0; k < B; ++k) {
        to_right[k] += from_right[k];
        to_scale[k] += from_scale[k];
      }
      from_right += B;
      from_scale += B;
    }
  }

 private:
  [[nodiscard]] static Offset panel_size(Index columns, Index rows) {
    return Offset{columns + rows} * B * Offset{columns} * B;
  }
  [[nodiscard]] Panel<B> own() const { return {panel(), reciprocals(), columns_, height(), stride()}; }

  void add_update(const Front& child, std::span<const Index> place) const {
    const Index count = child.rows();
    for (Index j = 0; j < count; ++j) {
      const Index column = place[static_cast<std::size_t>(j)];
      const double* const from = child.update(j);
      const Offset from_stride = child.update_stride(j);
      for (Index i = j; i < count;) {
        const Index row = place[static_cast<std::size_t>(i)];
        Index end = i + 1;
        if (row < column) {
          add_transposed(from + Offset{i - j} * B, from_stride, block(column, row));
        } else {
          while (end < count && place[static_cast<std::size_t>(end)] == row + (end - i)) ++end;
          const Block to = block(row, column);
          add_rows<B>(from + Offset{i - j} * B, from_stride, to.data, to.stride, Offset{end - i} * B);
        }
        i = end;
      }
    }
  }

  [[nodiscard]] static Offset update_start(Index columns, Index rows) { return Offset{columns + 2 * rows} * B; }
  [[nodiscard]] double* row_scales() const { return right() + Offset{columns_ + rows_} * B; }

  [[nodiscard]] double* update(Index column) const {
    return update_ + update_start(columns_, rows_) +
           (Offset{column} * rows_ - Offset{column} * (Offset{column} - 1) / 2) * B * B;
  }
  [[nodiscard]] Offset update_stride(Index column) const { return Offset{rows_ - column} * B; }

  static void add_transposed(const double* from, Offset from_stride, Block to) {
    for (int column = 0; column < B; ++column) {
      for (int row = 0; row < B; ++row) to.data[row * to.stride + column] += from[column * from_stride + row];
    }
  }

  double* data_;
  double* update_;
  Index columns_;
  Index rows_;
};

}  // namespace chainslam::detail
