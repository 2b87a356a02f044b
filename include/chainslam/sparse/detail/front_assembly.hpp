#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <span>
#include <utility>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/block_matrix.hpp"
#include "chainslam/sparse/detail/front.hpp"
#include "chainslam/sparse/detail/front_tree.hpp"

namespace chainslam::detail {

/// Sums up a node's front: the terms whose first variable in the order of elimination is its own, and what its children
/// leave. Keeps its memory from front to front.
template <int B>
class FrontAssembly {
 public:
  void add_variable() { place_.push_back(-1); }
  /// As many as are missing.
  void add_variables(Index size) {
    if (to_index(place_.size()) < size) place_.resize(size, -1);
  }
  void drop_last_variable() { place_.pop_back(); }

  void assemble(const FrontTree<B>& tree, const BlockTerms<B>& terms, const Table<char>& fixed, Index node) {
    const Front<B> front = tree.front(node);
    front.set_zero();
    Index place = 0;
    for (const Index variable : tree.variables(node)) place_[variable] = place++;
    for (const Index variable : tree.columns(node))
      if (terms.first(variable) != -1) prefetch(terms, terms.slot(terms.first(variable)).term);
    Index column = 0;
    for (const Index variable : tree.columns(node)) {
      for (Index k = terms.first(variable); k != -1;) {
        const Index term = terms.slot(k).term;
        k = terms.slot(k).next;
        if (k != -1) prefetch(terms, terms.slot(k).term);
        if (find_places(terms.slots(term), fixed, column)) add_term(front, terms, term);
      }
      ++column;
    }
    for (Index child = tree[node].first_child; child != -1; child = tree[child].next) {
      places_.clear();
      for (const Index row : tree.rows(child)) places_.push_back(place_[row]);
      front.add_child(tree.front(child), places_.range(0, places_.size()));
    }
    for (const Index variable : tree.variables(node)) place_[variable] = -1;
  }

 private:
  /// Places of a term's variables in the front, -1 for fixed ones.
  /// @returns whether the variable in own column `column` is the first of them that is eliminated.
  [[nodiscard]] bool find_places(std::span<const typename BlockTerms<B>::Slot> slots, const Table<char>& fixed,
                                 Index column) {
    places_.clear();
    for (const auto& slot : slots) {
      const Index place = place_[slot.variable];
      if (fixed[slot.variable] == 0 && place < column) return false;
      places_.push_back(place);
    }
    return true;
  }

  /// Terms lie in memory in the order in which they were added, not in that of elimination.
  static void prefetch(const BlockTerms<B>& terms, Index term) {
    constexpr Offset line = 64 / sizeof(double), most = 128;
    for (Offset k = 0; k < std::min(terms.size(term), most); k += line) __builtin_prefetch(terms.jacobian(term) + k);
  }

  void add_term(const Front<B>& front, const BlockTerms<B>& terms, Index term) const {
    const double* const jacobian = terms.jacobian(term);
    const double* const residual = terms.residual(term);
    const Offset stride = places_.size() * B;
    const Offset rows = terms.rows(term);
    for (Offset a = 0; a < places_.size(); ++a) {
      if (places_[a] == -1) continue;
      const double* const of_a = jacobian + a * B;
      add_to_right(of_a, stride, residual, rows, front.scale(places_[a]), front.right() + Offset{places_[a]} * B);
      for (Offset b = 0; b < places_.size(); ++b) {
        if (places_[b] == -1 || places_[b] > places_[a]) continue;
        const auto block = front.block(places_[a], places_[b]);
        add_product<B>(B, of_a, stride, jacobian + b * B, stride, rows, block.data, block.stride);
      }
    }
  }

  /// Adds to the matrix's diagonal, and to the right-hand side. In copies that nothing else can be: in registers.
  static void add_to_right(const double* jacobian, Offset stride, const double* residual, Offset rows, double* scale,
                           double* right) {
    std::array<double, B> squares, products;
    std::copy_n(scale, B, squares.data());
    std::copy_n(right, B, products.data());
    for (Offset row = 0; row < rows; ++row, jacobian += stride) {
#pragma GCC unroll 12
      for (std::size_t k = 0; k < B; ++k) {
        squares[k] += jacobian[k] * jacobian[k];
        products[k] -= jacobian[k] * residual[row];
      }
    }
    std::copy_n(squares.data(), B, scale);
    std::copy_n(products.data(), B, right);
  }

  Table<Index> place_;  ///< of each variable in the front at hand; -1 where it is not in it
  Table<Index> places_;
};

}  // namespace chainslam::detail
