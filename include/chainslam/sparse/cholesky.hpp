#pragma once

#include <algorithm>
#include <array>
#include <cassert>
#include <numeric>
#include <span>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/block_matrix.hpp"
#include "chainslam/sparse/concepts.hpp"
#include "chainslam/sparse/detail/front.hpp"
#include "chainslam/sparse/detail/inverse_fronts.hpp"
#include "chainslam/sparse/detail/panel.hpp"
#include "chainslam/sparse/detail/supernodes.hpp"
#include "chainslam/sparse/detail/tree_parts.hpp"

namespace chainslam {

/// Sparse Cholesky factorization of matrices of `BlockSize` x `BlockSize` blocks: symbolic once, numeric many times, no
/// allocation in the numeric part, no recursion.
///
/// Multifrontal on supernodes of block columns (Duff and Reid 1983; Liu 1992, "The multifrontal method for sparse
/// matrix solution"); the dense work is done by tiles whose width is the block's.
template <int BlockSize, class Order = Amd>
class BlockCholesky {
  static_assert(Ordering<Order>,
                "BlockCholesky: Order needs `std::vector<Index> operator()(const BlockPattern&) const`, as in Amd; see "
                "chainslam/sparse/concepts.hpp");

 public:
  static constexpr int block_size = BlockSize;  ///< rows and columns of a block
  using Matrix = BlockMatrix<BlockSize>;        ///< what is factorized

  /// How it orders and factorizes.
  struct Options {
    [[no_unique_address]] Order order{};  ///< the order of elimination
    /// A pivot counts as zero when elimination has left less than this share of the matrix's diagonal entry.
    double pivot_tolerance = 1e-14;
  };

  BlockCholesky() = default;
  explicit BlockCholesky(Options options) : options_(std::move(options)) {}  ///< with options

  /// Orders the columns, finds the factor's pattern and takes all memory that `factorize` and `solve` need.
  void analyze(const BlockPattern& pattern) {
    nodes_ = detail::find_supernodes(pattern, options_.order(pattern), BlockSize);
    lay_out_panels();
    link_children();
    whole_ = above_ = {};
    parts_.clear();
    left_.clear();
    whole_.supernodes.resize(static_cast<std::size_t>(nodes_.size()));
    std::iota(whole_.supernodes.begin(), whole_.supernodes.end(), 0);
    take_memory(whole_);
    place_entries(pattern);
    reciprocals_.resize(Offset{pattern.size()} * BlockSize);
    scale_.resize(Offset{pattern.size()} * BlockSize);
    work_.resize(Offset{pattern.size()} * BlockSize);
  }

  /// Factorizes matrix + diag(damping).
  ///
  /// @param matrix   has the analysed pattern.
  /// @param damping  one entry for each scalar row, or empty for none.
  [[nodiscard]] FactorizationResult factorize(const Matrix& matrix, std::span<const double> damping = {}) {
    assert(matrix.size() == to_index(nodes_.order.size()));
    assert(damping.empty() || static_cast<Offset>(damping.size()) == work_.size());
    factorize(whole_, matrix, damping, Serial{}, matrix.size());
    return result(whole_.bad_column);
  }

  /// The same, bit-identically, with subtrees and the columns of large fronts shared out by an executor. Takes some
  /// more memory the first time.
  template <Executor Exec>
  [[nodiscard]] FactorizationResult factorize(const Matrix& matrix, std::span<const double> damping,
                                              const Exec& executor) {
    assert(matrix.size() == to_index(nodes_.order.size()));
    assert(damping.empty() || static_cast<Offset>(damping.size()) == work_.size());
    if (left_.size() != nodes_.parent.size()) divide();
    const Index size = matrix.size();
    executor.for_chunks(to_index(parts_.size()), 1, [&](Index begin, Index end) {
      for (Index k = begin; k < end; ++k)
        factorize(parts_[static_cast<std::size_t>(k)], matrix, damping, Serial{}, size);
    });
    Index bad = -1;  // the first in the order of elimination
    for (const detail::TreePart& part : parts_) {
      if (part.bad_column != -1 && (bad == -1 || part.bad_column < bad)) bad = part.bad_column;
    }
    factorize(above_, matrix, damping, executor, bad == -1 ? size : bad);
    if (above_.bad_column != -1) bad = above_.bad_column;
    return result(bad);
  }

  /// Replaces x by (matrix + diag(damping))^-1 x of the last factorization, which must have succeeded.
  void solve(std::span<double> x) {
    assert(static_cast<Offset>(x.size()) == work_.size());
    for (Index k = 0; k < to_index(nodes_.order.size()); ++k)
      std::copy_n(x.data() + Offset{nodes_.order[k]} * BlockSize, BlockSize, work_.data() + Offset{k} * BlockSize);
    for (Index s = 0; s < nodes_.size(); ++s) substitute_forward(s);
    for (Index s = nodes_.size() - 1; s >= 0; --s) substitute_backward(s);
    for (Index k = 0; k < to_index(nodes_.order.size()); ++k)
      std::copy_n(work_.data() + Offset{k} * BlockSize, BlockSize, x.data() + Offset{nodes_.order[k]} * BlockSize);
  }

  /// Writes the diagonal blocks of (matrix + diag(damping))^-1 of the last factorization, which must have succeeded:
  /// column-major, at `BlockSize`^2 times their block column's number. Costs about two factorizations; allocates.
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
  [[nodiscard]] std::span<const Index> elimination_order() const { return nodes_.order.all(); }

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
  [[nodiscard]] detail::Panel<BlockSize> front_panel(Index s) {
    return {panel(s), reciprocals_.data() + Offset{nodes_.first_column[s]} * BlockSize, nodes_.columns(s),
            nodes_.front_rows(s), stride(s)};
  }
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

  void link_children() {
    last_child_.assign(nodes_.size(), -1);
    previous_sibling_.assign(nodes_.size(), -1);
    part_of_.assign(nodes_.size(), -1);
    for (Index s = 0; s < nodes_.size(); ++s) {
      const Index parent = nodes_.parent[s];
      if (parent == -1) continue;
      previous_sibling_[s] = last_child_[parent];
      last_child_[parent] = s;
    }
  }

  template <class Visit>
  void for_each_child(Index s, Visit&& visit) const {
    for (Index child = last_child_[s]; child != -1; child = previous_sibling_[child]) visit(child);
  }

  /// Whether a child's update waits among those of its parent's part.
  [[nodiscard]] bool waits_in(const detail::TreePart& part, Index child) const {
    return &part != &above_ || part_of_[child] == -1;
  }

  void take_memory(detail::TreePart& part) {
    part.take_memory(
        nodes_,
        [&](Index s, auto&& visit) {
          for_each_child(s, [&](Index child) {
            if (waits_in(part, child)) visit(child);
          });
        },
        [&](Index s) { return square(nodes_.update_rows(s)); });
  }

  void divide() {
    part_of_ = detail::divide_tree(
        nodes_.size(), [&](Index s) { return nodes_.parent[s]; },
        [&](Index s) { return detail::Front<BlockSize>::work(nodes_.columns(s), nodes_.update_rows(s)); });
    for (Index s = 0; s < nodes_.size(); ++s) {
      if (part_of_[s] >= to_index(parts_.size())) parts_.resize(static_cast<std::size_t>(part_of_[s]) + 1);
      (part_of_[s] == -1 ? above_ : parts_[static_cast<std::size_t>(part_of_[s])]).supernodes.push_back(s);
    }
    for (detail::TreePart& part : parts_) take_memory(part);
    take_memory(above_);
    left_.assign(nodes_.size(), nullptr);
  }

  /// Factorizes a part's supernodes, up to the first bad pivot, or column `stop`.
  template <class Exec>
  void factorize(detail::TreePart& part, const Matrix& matrix, std::span<const double> damping, const Exec& executor,
                 Index stop) {
    std::array<Offset, 2> top{0, 0};
    part.bad_column = -1;
    for (const Index s : part.supernodes) {
      if (nodes_.first_column[s] >= stop) return;
      std::fill_n(panel(s), panel_start_[Offset{s} + 1] - panel_start_[s], 0.0);
      assemble(s, matrix, damping);
      const detail::Panel<BlockSize> front = front_panel(s);
      const std::size_t own = nodes_.odd_level[s];
      double* const update = part.stacks[own].data() + top[own];
      const Offset update_size = square(nodes_.update_rows(s));
      std::fill_n(update, update_size, 0.0);
      top[own] += update_size;
      for_each_child(s, [&](Index child) {
        const double* of_child = nullptr;
        if (waits_in(part, child)) {
          top[1 - own] -= square(nodes_.update_rows(child));
          of_child = part.stacks[1 - own].data() + top[1 - own];
        } else {
          of_child = left_[child];
        }
        extend_add(of_child, nodes_.rows_in_parent(child), front, update);
      });
      const Index first = nodes_.first_column[s];
      const Index bad = front.eliminate(scale_.data() + Offset{first} * BlockSize, options_.pivot_tolerance);
      if (bad != -1) {
        part.bad_column = first + bad;
        return;
      }
      const Offset update_stride = Offset{nodes_.update_rows(s)} * BlockSize;
      executor.for_chunks(nodes_.update_rows(s), 4, [&](Index begin, Index end) {
        for (Index j = begin; j < end; ++j)
          front.subtract_from_update(j, update + Offset{j} * BlockSize * (update_stride + 1), update_stride);
      });
      if (part_of_[s] != -1) left_[s] = update;
    }
  }

  [[nodiscard]] FactorizationResult result(Index bad_column) const {
    if (bad_column == -1) return {};
    return {FactorizationStatus::not_positive_definite, nodes_.order[bad_column]};
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
      place = nodes_.columns(s) + (std::lower_bound(rows.begin(), rows.end(), row) - rows.begin());
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
    front_panel(s).substitute_forward(front_.data());
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
    front_panel(s).substitute_backward(front_.data(), nodes_.update_rows(s));
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
  detail::Table<Index> part_of_;  ///< of each supernode, where the tree is divided: its part, -1 above
  detail::TreePart whole_;
  std::vector<detail::TreePart> parts_;
  detail::TreePart above_;
  detail::Table<const double*> left_;  ///< of each supernode in a part: its update, to be taken by what is above
  detail::Table<double> work_;
  detail::Table<double> front_;
};
static_assert(LinearSolver<BlockCholesky<6>>);

/// A `BlockCholesky` that shares its factorizations out by an executor, which must outlive it.
template <int BlockSize, Executor Exec>
class ParallelCholesky : public BlockCholesky<BlockSize> {
 public:
  explicit ParallelCholesky(const Exec& executor) : executor_(executor) {}  ///< which must outlive it
  /// See `BlockCholesky::factorize`; bit-identical.
  [[nodiscard]] FactorizationResult factorize(const BlockMatrix<BlockSize>& matrix,
                                              std::span<const double> damping = {}) {
    if constexpr (std::is_same_v<Exec, Serial>) return BlockCholesky<BlockSize>::factorize(matrix, damping);
    return BlockCholesky<BlockSize>::factorize(matrix, damping, executor_);
  }

 private:
  const Exec& executor_;
};

}  // namespace chainslam
