#pragma once

#include <span>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/dense_kernels.hpp"

namespace chainslam::detail {

/// Some block columns of a Cholesky factor with the same rows, themselves included, column-major.
template <int B>
struct Panel {
  double* data;
  double* reciprocals;  ///< of the factor's diagonal
  Index columns;
  Index height;   ///< block rows
  Offset stride;  ///< distance between scalar columns

  [[nodiscard]] double* diagonal(Index j) const { return data + Offset{j} * B * (stride + 1); }

  /// Factorizes the columns.
  /// @param scale  the matrix's diagonal before elimination; may lie where the reciprocals go.
  /// @returns the column with a bad pivot, or -1.
  [[nodiscard]] Index eliminate(const double* scale, double pivot_tolerance) const {
    for (Index j = 0; j < columns; ++j) {
      const double* const left = data + Offset{j} * B;
      double* const own = diagonal(j);
      subtract_product<B>(Offset{height - j} * B, left, stride, left, stride, Offset{j} * B, own, stride);
      double* const reciprocal = reciprocals + Offset{j} * B;
      if (!factorize_block<B>(own, stride, scale + Offset{j} * B, pivot_tolerance, reciprocal)) return j;
      solve_from_right<B>(Offset{height - j - 1} * B, own, stride, reciprocal, own + B, stride);
    }
    return -1;
  }

  /// Subtracts what the columns tell of their rows below, seen from row `j` of these on, from column `j` of an update.
  void subtract_from_update(Index j, double* update, Offset update_stride) const {
    const double* const left = data + Offset{columns + j} * B;
    subtract_product<B>(Offset{height - columns - j} * B, left, stride, left, stride, Offset{columns} * B, update,
                        update_stride);
  }

  /// Applies the factor's inverse to the own part of `x` and subtracts it from the rest.
  void substitute_forward(double* x) const {
    for (Index j = 0; j < columns; ++j, x += B) {
      const double* const own = diagonal(j);
      substitute_block_forward<B>(own, stride, reciprocals + Offset{j} * B, x);
      subtract_product<1>(Offset{height - j - 1} * B, own + B, stride, x, 1, B, x + B, stride);
    }
  }

  /// The same for N of them, column-major.
  /// @param solved  workspace for the own part of all, transposed.
  template <int N>
  void substitute_forward(double* X, Offset x_stride, double* solved) const {
    for (Index j = 0; j < columns; ++j) {
      const Offset first = Offset{j} * B;
      subtract_product<N>(B, data + first, stride, solved, N, first, X + first, x_stride);
      for (int column = 0; column < N; ++column) {
        double* const x = X + column * x_stride + first;
        substitute_block_forward<B>(diagonal(j), stride, reciprocals + first, x);
        for (int k = 0; k < B; ++k) solved[(first + k) * N + column] = x[k];
      }
    }
    const Offset own = Offset{columns} * B;
    subtract_product<N>(Offset{height - columns} * B, data + own, stride, solved, N, own, X + own, x_stride);
  }

  /// Turns the own part of `x` into the solution, given that of the first `known` block rows below.
  void substitute_backward(double* solution, Index known) const {
    for (Index j = columns - 1; j >= 0; --j) {
      double* const x = solution + Offset{j} * B;
      const double* const own = diagonal(j);
      subtract_dots<B>(Offset{columns + known - j - 1} * B, own + B, stride, x + B, x);
      substitute_block_backward<B>(own, stride, reciprocals + Offset{j} * B, x);
    }
  }
};

/// Adds `B` columns of `rows` rows.
template <int B>
void add_rows(const double* from, Offset from_stride, double* to, Offset to_stride, Offset rows) {
  for (int column = 0; column < B; ++column, from += from_stride, to += to_stride) {
    for (Offset row = 0; row < rows; row += B) {
      for (int k = 0; k < B; ++k) to[row + k] += from[row + k];
    }
  }
}

/// Adds a child's update, a square of all its rows, to its parent's panel and to the parent's own update (extend-add).
/// @param place  of the child's rows in the parent's front, ascending.
template <int B>
void extend_add(const double* update, std::span<const Index> place, const Panel<B>& parent, double* parent_update) {
  const Offset from_stride = static_cast<Offset>(place.size()) * B;
  for (std::size_t j = 0; j < place.size(); ++j) {
    const bool own = place[j] < parent.columns;
    const Offset to_stride = own ? parent.stride : Offset{parent.height - parent.columns} * B;
    const Index shift = own ? 0 : parent.columns;
    double* const to = (own ? parent.data : parent_update) + Offset{place[j] - shift} * B * to_stride;
    const double* const from = update + static_cast<Offset>(j) * B * from_stride;
    for (std::size_t i = j; i < place.size();) {
      std::size_t end = i + 1;
      while (end < place.size() && place[end] == place[end - 1] + 1) ++end;
      add_rows<B>(from + static_cast<Offset>(i) * B, from_stride, to + Offset{place[i] - shift} * B, to_stride,
                  static_cast<Offset>(end - i) * B);
      i = end;
    }
  }
}

}  // namespace chainslam::detail
