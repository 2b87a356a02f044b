#pragma once

#include <algorithm>
#include <cstddef>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/dense_kernels.hpp"

namespace chainslam::detail {

/// The blocks of H^-1 where the factor L of H = L L^T is not zero, front by front, from the roots down: about twice the
/// work of the factorization.
///
/// Takahashi, Fagan and Chen 1973; Erisman and Tinney 1975; on supernodes: Campbell and Davis 1995.
template <int B>
class InverseFronts {
 public:
  /// @param tree   gives `roots()`, `columns(s)` and `rows(s)` (block counts), `panel(s)` (the front's columns of the
  /// factor, column-major, all its rows), `reciprocals(s)` (of its diagonal), and `for_each_child(s, take)`, which
  /// calls take(child, place of each of the child's rows in s): least memory is taken if the largest comes first.
  /// @param visit  called as visit(s, Z, stride) for each front; Z is the inverse among its variables, column-major,
  /// both triangles.
  template <class Tree, class Visit>
  void run(Tree&& tree, Visit&& visit) {
    for (const Index root : tree.roots()) waiting_.push_back({root, 0, 0, 0, false});
    while (waiting_.size() > 0) {
      const Waiting front = waiting_.back();
      waiting_.pop_back();
      const Index columns = tree.columns(front.node);
      const Offset stride = Offset{columns + tree.rows(front.node)} * B;
      double* const inverse = with_rows(front, columns, stride);
      complete(tree.panel(front.node), tree.reciprocals(front.node), columns, stride, inverse);
      visit(front.node, static_cast<const double*>(inverse), stride);
      bool last = true;  // the first to wait
      tree.for_each_child(front.node, [&](Index child, std::span<const Index> places) {
        waiting_.push_back({child, held(front) + 1, stride, places_.size(), std::exchange(last, false)});
        places_.append(places);
      });
    }
  }

 private:
  static constexpr Offset least_large = 300;  ///< rows; if smaller fronts gave back memory too, all took 8 % longer

  /// Last in, first out.
  struct Waiting {
    Index node;
    std::size_t above;    ///< how many inverses are held with its parent's, the last of them; 0 of a root
    Offset above_stride;  ///< of its parent's
    Offset first_place;   ///< in `places_`
    bool last;            ///< of the parent's children to come: the parent's inverse is of no use then
  };

  /// How many inverses are held besides the front's own: those that other children wait for.
  [[nodiscard]] static std::size_t held(const Waiting& front) { return front.last ? front.above - 1 : front.above; }

  /// Memory for a front's inverse, with what its parent's says of its rows. Of the last child it takes the place of the
  /// parent's, so that a path along which each front is the last needs two at a time.
  double* with_rows(const Waiting& front, Index columns, Offset stride) {
    const std::size_t place = held(front);
    // Gives back what other subtrees took, where that costs little next to the inverse.
    if (held_.size() < place + 1 || stride >= least_large) held_.resize(place + 1);
    Table<double>& own = front.last ? spare_ : held_[place];
    if (own.size() < stride * stride) own.resize(stride * stride);
    if (front.above > 0) {
      copy_rows(held_[front.above - 1].data(), front.above_stride, places_.range(front.first_place, places_.size()),
                columns, stride, own.data());
      places_.resize(front.first_place);
    }
    if (front.last) std::swap(held_[place], spare_);
    return held_[place].data();
  }

  /// What a front's inverse says of a child's rows goes behind the child's own columns.
  static void copy_rows(const double* from, Offset from_stride, std::span<const Index> places, Index columns,
                        Offset stride, double* inverse) {
    double* to = inverse + Offset{columns} * B * (stride + 1);
    for (const Index column : places) {
      for (Offset k = 0; k < B; ++k, to += stride) {
        const double* const from_column = from + (Offset{column} * B + k) * from_stride;
        double* block = to;
        for (const Index row : places) {
          std::copy_n(from_column + Offset{row} * B, B, block);
          block += B;
        }
      }
    }
  }

  /// Completes a front's inverse Z, whose part behind the own columns is known, block column by block column from the
  /// last: with Y = L_Sj L_jj^-1, Z_Sj = -Z_SS Y and Z_jj = L_jj^-T L_jj^-1 - Y^T Z_Sj.
  void complete(const double* panel, const double* reciprocals, Index columns, Offset stride, double* Z) {
    y_.resize(stride * B);
    y_transposed_.resize(stride * B);
    for (Index j = columns - 1; j >= 0; --j) {
      const Offset first = Offset{j} * B;
      const Offset rest = stride - first - B;
      const double* const diagonal = panel + first * (stride + 1);
      double* const z_diagonal = Z + first * (stride + 1);
      double* const z = z_diagonal + B;
      divide(diagonal, stride, reciprocals + first, rest);
      for (int c = 0; c < B; ++c) std::fill_n(z + c * stride, rest, 0.0);
      subtract_product<B>(rest, z_diagonal + B * (stride + 1), stride, y_transposed_.data(), B, rest, z, stride);
      invert_block(diagonal, stride, reciprocals + first, z_diagonal);
      for (int c = 0; c < B; ++c) subtract_dots<B>(rest, z, stride, y_.data() + c * rest, z_diagonal + c * stride);
      for (int c = 0; c < B; ++c) {  // rounding differs above and below the diagonal
        for (int r = 0; r < c; ++r) z_diagonal[c * stride + r] = z_diagonal[r * stride + c];
      }
      for (Offset r = 0; r < rest; ++r) {
        for (int c = 0; c < B; ++c) z_diagonal[(B + r) * stride + c] = z[c * stride + r];
      }
    }
  }

  /// Y = L_Sj L_jj^-1 and its transpose.
  void divide(const double* diagonal, Offset stride, const double* reciprocals, Offset rest) {
    for (int c = B - 1; c >= 0; --c) {
      double* const column = y_.data() + c * rest;
      std::copy_n(diagonal + c * stride + B, rest, column);
      for (int k = c + 1; k < B; ++k) {
        const double factor = diagonal[c * stride + k];
        const double* const later = y_.data() + k * rest;
        for (Offset r = 0; r < rest; ++r) column[r] -= later[r] * factor;
      }
      for (Offset r = 0; r < rest; ++r) {
        column[r] *= reciprocals[c];
        y_transposed_[r * B + c] = column[r];
      }
    }
  }

  /// (L L^T)^-1 of a diagonal block.
  static void invert_block(const double* l, Offset stride, const double* reciprocals, double* out) {
    double inverse[B * B] = {};  // of L, column-major
    for (int c = 0; c < B; ++c) {
      inverse[c * B + c] = reciprocals[c];
      for (int r = c + 1; r < B; ++r) {
        double sum = 0.0;
        for (int k = c; k < r; ++k) sum += l[k * stride + r] * inverse[c * B + k];
        inverse[c * B + r] = -sum * reciprocals[r];
      }
    }
    for (int c = 0; c < B; ++c) {
      for (int r = 0; r < B; ++r) {
        double sum = 0.0;
        for (int k = std::max(r, c); k < B; ++k) sum += inverse[r * B + k] * inverse[c * B + k];
        out[c * stride + r] = sum;
      }
    }
  }

  std::vector<Table<double>> held_;  ///< inverses that children wait for, from the roots down
  Table<double> spare_;
  Table<Waiting> waiting_;
  Table<Index> places_;  ///< of the rows of those that wait, in their parents
  Table<double> y_;
  Table<double> y_transposed_;
};

}  // namespace chainslam::detail
