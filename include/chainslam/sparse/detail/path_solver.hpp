#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <utility>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/detail/front.hpp"
#include "chainslam/sparse/detail/front_tree.hpp"

namespace chainslam::detail {

/// Rows of few of many variables, by their numbers: memory and time are those of the few.
class RowMap {
 public:
  /// The row of a variable, -1 if it has none.
  [[nodiscard]] Index operator[](Index variable) const { return slots_[slot_of(variable)].row; }

  /// Gives a variable without a row one.
  void add(Index variable, Index row) {
    if (2 * ++count_ > slots_.size()) grow();
    slots_[slot_of(variable)] = {variable, row};
  }

 private:
  static constexpr Offset smallest = 64;

  struct Slot {
    Index variable = -1, row = -1;
  };

  /// Where it is, or may be put.
  [[nodiscard]] Offset slot_of(Index variable) const {
    const auto mask = static_cast<std::uint32_t>(slots_.size() - 1);
    std::uint32_t slot = static_cast<std::uint32_t>(variable) * 0x9e3779b1U;
    for (slot ^= slot >> 15U;; ++slot) {
      const Slot& at = slots_[Offset{slot & mask}];
      if (at.variable == variable || at.variable == -1) return Offset{slot & mask};
    }
  }

  [[gnu::cold]] void grow() {
    const Table<Slot> before = std::exchange(slots_, Table<Slot>(2 * slots_.size()));
    for (const Slot& one : before)
      if (one.variable != -1) slots_[slot_of(one.variable)] = one;
  }

  Table<Slot> slots_{smallest};  ///< a power of two, half of them free at least
  Offset count_ = 0;
};

/// Substitutes right-hand sides that touch few variables: only the fronts from there to the roots take part.
template <int B>
class PathSolver {
 public:
  /// @param variables  that the right-hand sides touch; all are eliminated in the tree.
  PathSolver(const FrontTree<B>& tree, std::span<const Index> variables) : tree_(tree) {
    for (const Index variable : variables) {
      const Offset begin = nodes_.size();
      for (Index node = tree.node_of(variable); node != -1 && !seen(node); node = tree[node].parent) {
        nodes_.push_back(node);
        for (const Index column : tree.columns(node)) row_.add(column, rows_++);
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
    substitute(X.data(), columns);
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

  /// All right-hand sides, column-major, all the way up: those of a front while it is in the cache.
  void substitute(double* X, Index columns) const {
    const Offset height = Offset{rows_} * B;
    Table<double> gathered, solved;
    Table<Offset> places;  // of the front's variables in X
    for (Offset k = nodes_.size(); k-- > 0;) {
      const auto front = tree_.front(nodes_[k]);
      gathered.resize(front.stride() * B);
      solved.resize(Offset{front.columns()} * B * B);
      places.clear();
      for (const Index variable : tree_.variables(nodes_[k])) places.push_back(Offset{row_[variable]} * B);
      Index column = 0;
      for (; column + B <= columns; column += B)
        substitute<B>(front, places, X + column * height, gathered.data(), solved.data());
      for (; column < columns; ++column)
        substitute<1>(front, places, X + column * height, gathered.data(), solved.data());
    }
  }

  /// N of them by one front.
  template <int N>
  void substitute(const auto& front, const Table<Offset>& places, double* X, double* gathered, double* solved) const {
    const Offset height = Offset{rows_} * B;
    double* to = gathered;
    for (int column = 0; column < N; ++column)
      for (const Offset place : places) to = std::copy_n(X + column * height + place, B, to);
    front.template substitute_forward<N>(gathered, solved);
    const double* from = gathered;
    for (int column = 0; column < N; ++column)
      for (const Offset place : places) {
        std::copy_n(from, B, X + column * height + place);
        from += B;
      }
  }

  const FrontTree<B>& tree_;
  Table<Index> nodes_;  ///< a later way ends below an earlier one's node: parents before children
  RowMap row_;          ///< of each variable eliminated in them
  Index rows_ = 0;
};

}  // namespace chainslam::detail
