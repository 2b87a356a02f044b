#pragma once

#include <algorithm>
#include <span>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/detail/front.hpp"
#include "chainslam/sparse/detail/front_tree.hpp"

namespace chainslam::detail {

/// Substitutes right-hand sides that touch few variables: only the fronts from there to the roots take part.
template <int B>
class PathSolver {
 public:
  /// @param size       number of variables in the tree
  /// @param variables  that the right-hand sides touch; all are eliminated in the tree.
  PathSolver(const FrontTree<B>& tree, Index size, std::span<const Index> variables) : tree_(tree), row_(size, -1) {
    for (const Index variable : variables) {
      const Offset begin = nodes_.size();
      for (Index node = tree.node_of(variable); node != -1 && !seen(node); node = tree[node].parent) {
        nodes_.push_back(node);
        for (const Index column : tree.columns(node)) row_[column] = rows_++;
      }
      std::reverse(nodes_.data() + begin, nodes_.data() + nodes_.size());
    }
  }

  /// E^T H^-1 E, where H is the matrix that was factorized.
  ///
  /// @param variables  of E's block rows; all that the constructor got, or some of them.
  /// @param E          `B` rows for each of them, column-major
  /// @param product    as many rows and columns as E has columns
  void inverse_product(std::span<const Index> variables, const double* E, Index columns, double* product) const {
    const Offset height = Offset{rows_} * B;
    Table<double> X(height * columns, 0.0);
    for (Index column = 0; column < columns; ++column) {
      double* const x = X.data() + column * height;
      for (const Index variable : variables)
        for (int k = 0; k < B; ++k) x[Offset{row_[variable]} * B + k] += *E++;
    }
    Index solved = 0;
    for (; solved + B <= columns; solved += B) substitute<B>(X.data() + solved * height);
    for (; solved < columns; ++solved) substitute<1>(X.data() + solved * height);
    std::fill_n(product, Offset{columns} * columns, 0.0);
    for (Index column = 0; column < columns; ++column) multiply(X.data(), height, column, columns, product);
  }

 private:
  [[nodiscard]] bool seen(Index node) const { return row_[tree_.columns(node).front()] != -1; }

  /// A column of X^T X, down to the diagonal, and its mirror image.
  static void multiply(const double* X, Offset height, Index column, Index columns, double* product) {
    double* const dots = product + Offset{column} * columns;
    const double* const x = X + column * height;
    Index other = 0;
    for (; other + B <= column + 1; other += B) subtract_dots<B>(height, X + other * height, height, x, dots + other);
    for (; other <= column; ++other) subtract_dots<1>(height, X + other * height, height, x, dots + other);
    for (other = 0; other <= column; ++other) {
      dots[other] = -dots[other];
      product[Offset{other} * columns + column] = dots[other];
    }
  }

  /// N right-hand sides, column-major, all the way up.
  template <int N>
  void substitute(double* X) const {
    const Offset height = Offset{rows_} * B;
    Table<double> gathered, solved;
    for (Offset k = nodes_.size(); k-- > 0;) {
      const std::span<const Index> variables = tree_.variables(nodes_[k]);
      const auto front = tree_.front(nodes_[k]);
      gathered.resize(front.stride() * N);
      solved.resize(Offset{front.columns()} * B * N);
      double* in_front = gathered.data();
      for (int column = 0; column < N; ++column)
        for (const Index variable : variables)
          in_front = std::copy_n(X + column * height + Offset{row_[variable]} * B, B, in_front);
      front.template substitute_forward<N>(gathered.data(), solved.data());
      const double* from = gathered.data();
      for (int column = 0; column < N; ++column)
        for (const Index variable : variables) {
          std::copy_n(from, B, X + column * height + Offset{row_[variable]} * B);
          from += B;
        }
    }
  }

  const FrontTree<B>& tree_;
  Table<Index> nodes_;  ///< a later way ends below an earlier one's node: parents before children
  Table<Index> row_;    ///< of each variable eliminated in them, -1 of the others
  Index rows_ = 0;
};

}  // namespace chainslam::detail
