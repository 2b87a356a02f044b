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
    std::fill_n(product, Offset{columns} * columns, 0.0);
    Workspace workspace;
    for (Offset k = nodes_.size(); k-- > 0;) add_front(nodes_[k], X.data(), columns, product, workspace);
    for (Index column = 0; column < columns; ++column)
      for (Index other = 0; other <= column; ++other) {
        double& entry = product[Offset{column} * columns + other];
        entry = -entry;
        product[Offset{other} * columns + column] = entry;
      }
  }

 private:
  /// Keeps its memory from front to front.
  struct Workspace {
    Table<Offset> places;  ///< of the front's variables in X: its own ones lie side by side
    Table<double> gathered, solved;
    Table<Index> begins;  ///< of columns that are not zero, `B` or 1 at a time
  };

  [[nodiscard]] bool seen(Index node) const { return row_[tree_.columns(node).front()] != -1; }

  /// Substitutes the right-hand sides in one front, all while it is in the cache, and subtracts from the product what
  /// the front's own rows add. Those that are zero there stay so.
  void add_front(Index node, double* X, Index columns, double* product, Workspace& workspace) const {
    const auto front = tree_.front(node);
    const Offset height = Offset{rows_} * B, own = Offset{front.columns()} * B;
    auto& [places, gathered, solved, begins] = workspace;
    places.clear();
    begins.clear();
    for (const Index variable : tree_.variables(node)) places.push_back(Offset{row_[variable]} * B);
    gathered.resize(front.stride() * B);
    solved.resize(own * B);
    const double* const rows = X + places[0];
    const auto width = [&](Index begin) { return begin < columns - columns % B ? B : 1; };
    for (Index begin = 0; begin < columns; begin += width(begin)) {
      if (is_zero(rows + begin * height, own, width(begin))) continue;
      begins.push_back(begin);
      if (width(begin) == B)
        substitute<B>(front, places, X + begin * height, gathered.data(), solved.data());
      else
        substitute<1>(front, places, X + begin * height, gathered.data(), solved.data());
      for (Index column = begin; column < begin + width(begin); ++column)
        for (const Index other : begins) {
          double* const dots = product + Offset{column} * columns + other;
          if (width(other) == B)
            subtract_dots<B>(own, rows + other * height, height, rows + column * height, dots);
          else
            subtract_dots<1>(own, rows + other * height, height, rows + column * height, dots);
        }
    }
  }

  /// Whether `own` rows of some columns are zero.
  [[nodiscard]] bool is_zero(const double* X, Offset own, Index columns) const {
    for (Index column = 0; column < columns; ++column, X += Offset{rows_} * B)
      if (std::any_of(X, X + own, [](double entry) { return entry != 0.0; })) return false;
    return true;
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
