#pragma once

#include <algorithm>
#include <array>
#include <cassert>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/sparse/block_matrix.hpp"
#include "chainslam/sparse/concepts.hpp"
#include "chainslam/sparse/detail/dense_kernels.hpp"
#include "chainslam/sparse/detail/inverse_fronts.hpp"
#include "chainslam/sparse/detail/supernodes.hpp"
#include "chainslam/sparse/detail/table.hpp"
#include "chainslam/sparse/ordering.hpp"

namespace chainslam {

/// Sparse Cholesky factorisation of matrices of `BlockSize` x `BlockSize` blocks: symbolic once, numeric many times, no
/// allocation in the numeric part, no recursion.
///
/// Multifrontal on supernodes of block columns (Duff and Reid 1983; Liu 1992, "The multifrontal method for sparse
/// matrix solution"); the dense work is done by tiles whose width is the block's.
template <int BlockSize, class Order = Amd>
class BlockCholesky {
  static_assert(Ordering<Order>,
                "BlockCholesky: Order needs `std::vector<Index> operator()(const BlockPattern&) const`, as in Amd");

 public:
  static constexpr int block_size = BlockSize;
  using Matrix = BlockMatrix<BlockSize>;

  struct Options {
    [[no_unique_address]] Order order{};
    /// A pivot counts as zero when elimination has left less than this share of the matrix's diagonal entry.
    double pivot_tolerance = 1e-14;
  };

  BlockCholesky() = default;
  explicit BlockCholesky(Options options) : options_(std::move(options)) {}

  /// Orders the columns, finds the factor's pattern and takes all memory that `factorize` and `solve` need.
  void analyze(const BlockPattern& pattern) {
    nodes_ = detail::find_supernodes(pattern, options_.order(pattern), BlockSize);
    lay_out_panels();
    lay_out_stacks();
    place_entries(pattern);
    reciprocals_.resize(Offset{pattern.size()} * BlockSize);
    scale_.resize(Offset{pattern.size()} * BlockSize);
    work_.resize(Offset{pattern.size()} * BlockSize);
  }

  /// Factorises matrix + diag(damping).
  ///
  /// @param matrix   has the analysed pattern.
  /// @param damping  one entry for each scalar row, or empty for none.
  [[nodiscard]] FactorizationResult factorize(const Matrix& matrix, std::span<const double> damping = {}) {
    assert(matrix.size() == to_index(nodes_.order.size()));
    assert(damping.empty() || static_cast<Offset>(damping.size()) == work_.size());
    std::array<Offset, 2> top{0, 0};
    for (Index s = 0; s < nodes_.size(); ++s) {
      std::fill_n(panel(s), panel_start_[Offset{s} + 1] - panel_start_[s], 0.0);
      assemble(s, matrix, damping);
      Offset& own_top = top[nodes_.odd_level[s]];
      Offset& child_top = top[1 - nodes_.odd_level[s]];
      double* const update = stacks_[nodes_.odd_level[s]].data() + own_top;
      const Offset update_size = square(nodes_.update_rows(s));
      std::fill_n(update, update_size, 0.0);
      own_top += update_size;
      for (Index c = 0, child = last_child_[s]; c < nodes_.child_count[s]; ++c, child = previous_sibling_[child]) {
        child_top -= square(nodes_.update_rows(child));
        add_update(child, s, stacks_[1 - nodes_.odd_level[s]].data() + child_top, update);
      }
      const Index bad_column = eliminate(s, update);
      if (bad_column >= 0) return {FactorizationStatus::not_positive_definite, nodes_.order[bad_column]};
    }
    return {};
  }

  /// Replaces x by (matrix + diag(damping))^-1 x of the last factorisation, which must have succeeded.
  void solve(std::span<double> x) {
    assert(static_cast<Offset>(x.size()) == work_.size());
    for (Index k = 0; k < to_index(nodes_.order.size()); ++k)
      std::copy_n(x.data() + Offset{nodes_.order[k]} * BlockSize, BlockSize, work_.data() + Offset{k} * BlockSize);
    for (Index s = 0; s < nodes_.size(); ++s) substitute_forward(s);
    for (Index s = nodes_.size() - 1; s >= 0; --s) substitute_backward(s);
    for (Index k = 0; k < to_index(nodes_.order.size()); ++k)
      std::copy_n(work_.data() + Offset{k} * BlockSize, BlockSize, x.data() + Offset{nodes_.order[k]} * BlockSize);
  }

  /// Writes the diagonal blocks of (matrix + diag(damping))^-1 of the last factorisation, which must have succeeded:
  /// column-major, at `BlockSize`^2 times their block column's number. Costs about two factorisations; allocates.
  void inverse_diagonal(std::span<double> out) const {
    assert(static_cast<Offset>(out.size()) == work_.size() * BlockSize);
    detail::InverseFronts<BlockSize>().run(Fronts{*this}, [&](Index s, const double* inverse, Offset step) {
      for (Index k = nodes_.first_column[s]; k < nodes_.first_column[Offset{s} + 1]; ++k) {
        double* const to = out.data() + Offset{nodes_.order[k]} * BlockSize * BlockSize;
        for (int c = 0; c < BlockSize; ++c) std::copy_n(inverse + c * step, BlockSize, to + c * BlockSize);
        inverse += BlockSize * (step + 1);
      }
    });
  }

  /// Coefficients that the factor stores, zeros kept on purpose included.
  [[nodiscard]] Offset stored_coefficients() const { return panels_.size(); }
  /// The caller's block columns in the order of their elimination.
  [[nodiscard]] std::span<const Index> elimination_order() const { return nodes_.order.vector(); }

 private:
  struct Entry {
    Offset block;        ///< in the matrix's pattern
    Offset destination;  ///< in `panels_`
    bool transposed;
  };

  /// The supernodes, as `InverseFronts` asks for them.
  struct Fronts {
    const BlockCholesky& of;

    [[nodiscard]] std::vector<Index> roots() const {
      std::vector<Index> found;
      for (Index s = 0; s < of.nodes_.size(); ++s) {
        if (of.nodes_.parent[s] == -1) found.push_back(s);
      }
      return found;
    }
    [[nodiscard]] Index columns(Index s) const { return of.nodes_.columns(s); }
    [[nodiscard]] Index rows(Index s) const { return of.nodes_.update_rows(s); }
    [[nodiscard]] const double* panel(Index s) const { return of.panel(s); }
    [[nodiscard]] const double* reciprocals(Index s) const {
      return of.reciprocals_.data() + Offset{of.nodes_.first_column[s]} * BlockSize;
    }
    template <class Take>
    void for_each_child(Index s, Take&& take) const {
      for (Index child = of.last_child_[s]; child != -1; child = of.previous_sibling_[child])
        take(child, of.nodes_.rows_in_parent(child));
    }
  };

  /// Coefficients of an update matrix with `rows` block rows.
  [[nodiscard]] static Offset square(Index rows) { return Offset{rows} * rows * BlockSize * BlockSize; }
  [[nodiscard]] double* panel(Index s) { return panels_.data() + panel_start_[s]; }
  [[nodiscard]] const double* panel(Index s) const { return panels_.data() + panel_start_[s]; }
  /// Distance between the columns of a supernode's panel.
  [[nodiscard]] Offset stride(Index s) const { return Offset{nodes_.front_rows(s)} * BlockSize; }

  void lay_out_panels() {
    panel_start_.assign(Offset{nodes_.size()} + 1, 0);
    Index most_rows = 0;
    for (Index s = 0; s < nodes_.size(); ++s) {
      panel_start_[Offset{s} + 1] = panel_start_[s] + stride(s) * nodes_.columns(s) * BlockSize;
      most_rows = std::max(most_rows, nodes_.front_rows(s));
    }
    panels_.resize(panel_start_[nodes_.size()]);
    front_.resize(Offset{most_rows} * BlockSize);
  }

  /// A supernode's update waits until its parent takes it. In a postorder, the updates of even levels and those of odd
  /// levels form a stack each, and a supernode takes from the one while it gives to the other.
  void lay_out_stacks() {
    last_child_.assign(nodes_.size(), -1);
    previous_sibling_.assign(nodes_.size(), -1);
    std::array<Offset, 2> top{0, 0};
    std::array<Offset, 2> highest{0, 0};
    for (Index s = 0; s < nodes_.size(); ++s) {
      const std::size_t own = nodes_.odd_level[s];
      top[own] += square(nodes_.update_rows(s));
      highest[own] = std::max(highest[own], top[own]);
      for (Index child = last_child_[s]; child != -1; child = previous_sibling_[child])
        top[1 - own] -= square(nodes_.update_rows(child));
      const Index parent = nodes_.parent[s];
      if (parent == -1) continue;
      previous_sibling_[s] = last_child_[parent];
      last_child_[parent] = s;
    }
    for (std::size_t parity = 0; parity < 2; ++parity) stacks_[parity].resize(highest[parity]);
  }

  void place_entries(const BlockPattern& pattern) {
    detail::Table<Index> supernode_of(pattern.size());
    for (Index s = 0; s < nodes_.size(); ++s) {
      for (Index column = nodes_.first_column[s]; column < nodes_.first_column[Offset{s} + 1]; ++column)
        supernode_of[column] = s;
    }
    const auto for_each_entry = [&](auto&& visit) {
      for (Index column = 0; column < pattern.size(); ++column) {
        for (Offset k = pattern.begin(column); k < pattern.end(column); ++k) {
          const Index i = nodes_.position[pattern.row(k)];
          const Index j = nodes_.position[column];
          visit(k, std::max(i, j), std::min(i, j), i < j);
        }
      }
    };
    entry_start_.assign(Offset{nodes_.size()} + 1, 0);
    for_each_entry([&](Offset, Index, Index column, bool) { ++entry_start_[Offset{supernode_of[column]} + 1]; });
    for (Index s = 0; s < nodes_.size(); ++s) entry_start_[Offset{s} + 1] += entry_start_[s];
    entries_.resize(pattern.blocks());
    detail::Table<Offset> next = entry_start_;
    for_each_entry([&](Offset block, Index row, Index column, bool transposed) {
      const Index s = supernode_of[column];
      entries_[next[s]++] = {block, destination(s, row, column), transposed};
    });
  }

  /// Place in `panels_` of block (row, column), numbered in the order of elimination.
  [[nodiscard]] Offset destination(Index s, Index row, Index column) const {
    const Index first = nodes_.first_column[s];
    Offset place = row - first;
    if (place >= nodes_.columns(s)) {
      const std::span<const Index> rows = nodes_.rows_of(s);
      place = nodes_.columns(s) + (std::ranges::lower_bound(rows, row) - rows.begin());
    }
    return panel_start_[s] + Offset{column - first} * BlockSize * stride(s) + place * BlockSize;
  }

  /// Copies the matrix's blocks of supernode s into its panel.
  void assemble(Index s, const Matrix& matrix, std::span<const double> damping) {
    using Panel = Eigen::Map<typename Matrix::Block, Eigen::Unaligned, Eigen::OuterStride<>>;
    const Eigen::OuterStride<> between_columns(stride(s));
    for (Offset e = entry_start_[s]; e < entry_start_[Offset{s} + 1]; ++e) {
      const Entry& entry = entries_[e];
      Panel to(panels_.data() + entry.destination, between_columns);
      if (entry.transposed) {
        to = matrix.block(entry.block).transpose();
      } else {
        to = matrix.block(entry.block);
      }
    }
    const Index columns = nodes_.columns(s);
    for (Index c = 0; c < columns * BlockSize; ++c) {
      double& diagonal = panel(s)[c * (stride(s) + 1)];
      const Offset k = Offset{nodes_.first_column[s]} * BlockSize + c;
      if (!damping.empty())
        diagonal += damping[static_cast<std::size_t>(Offset{nodes_.order[k / BlockSize]} * BlockSize + k % BlockSize)];
      scale_[k] = diagonal;
    }
  }

  /// Adds a child's update to its parent's panel and to the parent's own update (extend-add).
  void add_update(Index child, Index parent, const double* update, double* parent_update) {
    const std::span<const Index> place = nodes_.rows_in_parent(child);
    const Offset from_stride = static_cast<Offset>(place.size()) * BlockSize;
    const Index columns = nodes_.columns(parent);
    for (std::size_t j = 0; j < place.size(); ++j) {
      const bool own = place[j] < columns;
      const Offset to_stride = own ? stride(parent) : Offset{nodes_.update_rows(parent)} * BlockSize;
      const Index shift = own ? 0 : columns;
      double* const to = (own ? panel(parent) : parent_update) + Offset{place[j] - shift} * BlockSize * to_stride;
      const double* const from = update + static_cast<Offset>(j) * BlockSize * from_stride;
      for (std::size_t i = j; i < place.size();) {
        std::size_t end = i + 1;
        while (end < place.size() && place[end] == place[end - 1] + 1) ++end;
        add_rows(from + static_cast<Offset>(i) * BlockSize, from_stride, to + Offset{place[i] - shift} * BlockSize,
                 to_stride, static_cast<Offset>(end - i) * BlockSize);
        i = end;
      }
    }
  }

  /// Adds `BlockSize` columns of `rows` rows.
  static void add_rows(const double* from, Offset from_stride, double* to, Offset to_stride, Offset rows) {
    for (int column = 0; column < BlockSize; ++column, from += from_stride, to += to_stride) {
      for (Offset row = 0; row < rows; row += BlockSize) {
        Eigen::Map<Eigen::Matrix<double, BlockSize, 1>>(to + row) +=
            Eigen::Map<const Eigen::Matrix<double, BlockSize, 1>>(from + row);
      }
    }
  }

  /// Factorises a front: its own columns in the panel, the Schur complement of its rows in `update`.
  /// @returns the column with a bad pivot, numbered in the order of elimination, or -1.
  [[nodiscard]] Index eliminate(Index s, double* update) {
    const Index columns = nodes_.columns(s);
    const Index front_rows = nodes_.front_rows(s);
    const Offset step = stride(s);
    double* const front = panel(s);
    for (Index j = 0; j < columns; ++j) {
      const double* const left = front + Offset{j} * BlockSize;
      double* const diagonal = front + Offset{j} * BlockSize * (step + 1);
      detail::subtract_product<BlockSize>(Offset{front_rows - j} * BlockSize, left, step, left, step,
                                          Offset{j} * BlockSize, diagonal, step);
      const Index column = nodes_.first_column[s] + j;
      double* const reciprocals = reciprocals_.data() + Offset{column} * BlockSize;
      if (!detail::factorize_block<BlockSize>(diagonal, step, scale_.data() + Offset{column} * BlockSize,
                                              options_.pivot_tolerance, reciprocals))
        return column;
      detail::solve_from_right<BlockSize>(Offset{front_rows - j - 1} * BlockSize, diagonal, step, reciprocals,
                                          diagonal + BlockSize, step);
    }
    const Index rows = nodes_.update_rows(s);
    const Offset update_step = Offset{rows} * BlockSize;
    for (Index j = 0; j < rows; ++j) {
      const double* const left = front + Offset{columns + j} * BlockSize;
      detail::subtract_product<BlockSize>(Offset{rows - j} * BlockSize, left, step, left, step,
                                          Offset{columns} * BlockSize,
                                          update + Offset{j} * BlockSize * (update_step + 1), update_step);
    }
    return -1;
  }

  /// Gathers the entries of `work_` that a front touches.
  void gather(Index s) {
    const Offset own = Offset{nodes_.columns(s)} * BlockSize;
    std::copy_n(work_.data() + Offset{nodes_.first_column[s]} * BlockSize, own, front_.data());
    double* to = front_.data() + own;
    for (const Index row : nodes_.rows_of(s)) {
      std::copy_n(work_.data() + Offset{row} * BlockSize, BlockSize, to);
      to += BlockSize;
    }
  }

  void substitute_forward(Index s) {
    gather(s);
    const Offset step = stride(s);
    for (Index j = 0; j < nodes_.columns(s); ++j) {
      double* const x = front_.data() + Offset{j} * BlockSize;
      const double* const diagonal = panel(s) + Offset{j} * BlockSize * (step + 1);
      const double* const reciprocals = reciprocals_.data() + Offset{nodes_.first_column[s] + j} * BlockSize;
      for (int c = 0; c < BlockSize; ++c) {
        x[c] *= reciprocals[c];
        for (int r = c + 1; r < BlockSize; ++r) x[r] -= diagonal[c * step + r] * x[c];
      }
      detail::subtract_product<1>(Offset{nodes_.front_rows(s) - j - 1} * BlockSize, diagonal + BlockSize, step, x, 1,
                                  BlockSize, x + BlockSize, step);
    }
    const Offset own = Offset{nodes_.columns(s)} * BlockSize;
    std::copy_n(front_.data(), own, work_.data() + Offset{nodes_.first_column[s]} * BlockSize);
    const double* from = front_.data() + own;
    for (const Index row : nodes_.rows_of(s)) {
      std::copy_n(from, BlockSize, work_.data() + Offset{row} * BlockSize);
      from += BlockSize;
    }
  }

  void substitute_backward(Index s) {
    gather(s);
    const Offset step = stride(s);
    for (Index j = nodes_.columns(s) - 1; j >= 0; --j) {
      double* const x = front_.data() + Offset{j} * BlockSize;
      const double* const diagonal = panel(s) + Offset{j} * BlockSize * (step + 1);
      const double* const reciprocals = reciprocals_.data() + Offset{nodes_.first_column[s] + j} * BlockSize;
      detail::subtract_dots<BlockSize>(Offset{nodes_.front_rows(s) - j - 1} * BlockSize, diagonal + BlockSize, step,
                                       x + BlockSize, x);
      for (int c = BlockSize - 1; c >= 0; --c) {
        for (int r = c + 1; r < BlockSize; ++r) x[c] -= diagonal[c * step + r] * x[r];
        x[c] *= reciprocals[c];
      }
    }
    std::copy_n(front_.data(), Offset{nodes_.columns(s)} * BlockSize,
                work_.data() + Offset{nodes_.first_column[s]} * BlockSize);
  }

  Options options_;
  detail::Supernodes nodes_;
  detail::Table<Offset> panel_start_;
  detail::Table<double> panels_;       ///< of each supernode: its columns of the factor, column-major, all its rows
  detail::Table<double> reciprocals_;  ///< of the factor's diagonal
  detail::Table<double> scale_;        ///< the matrix's diagonal before elimination
  detail::Table<Offset> entry_start_;
  detail::Table<Entry> entries_;
  detail::Table<Index> last_child_;
  detail::Table<Index> previous_sibling_;
  std::array<detail::Table<double>, 2> stacks_;
  detail::Table<double> work_;
  detail::Table<double> front_;
};
static_assert(LinearSolver<BlockCholesky<6>>);

}  // namespace chainslam
