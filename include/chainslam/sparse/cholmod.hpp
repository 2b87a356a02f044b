#pragma once

#include <cholmod.h>

#include <algorithm>
#include <cstddef>
#include <memory>
#include <new>
#include <span>
#include <stdexcept>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/block_matrix.hpp"
#include "chainslam/sparse/concepts.hpp"

namespace chainslam {

/// `LinearSolver` by CHOLMOD (SuiteSparse 5.12): the second model, and the reference in tests and benchmarks.
///
/// Opt-in: include this header and link `chainslam::cholmod`. CHOLMOD's supernodal module is under the GPL; a program
/// linked with it has to respect that.
/// @throws std::bad_alloc if CHOLMOD finds no memory.
/// Chen, Davis, Hager and Rajamanickam 2008, "Algorithm 887: CHOLMOD".
template <int BlockSize>
class Cholmod {
 public:
  static constexpr int block_size = BlockSize;  ///< rows and columns of a block
  using Matrix = BlockMatrix<BlockSize>;        ///< what is factorized
  /// CHOLMOD's ways to factorize.
  enum class Method { automatic, simplicial, supernodal };

  /// Ordering is CHOLMOD's AMD on scalar columns.
  explicit Cholmod(Method method = Method::automatic) {
    cholmod_start(common());
    common()->print = 0;
    common()->nmethods = 1;
    common()->method[0].ordering = CHOLMOD_AMD;
    common()->supernodal = method == Method::automatic    ? CHOLMOD_AUTO
                           : method == Method::simplicial ? CHOLMOD_SIMPLICIAL
                                                          : CHOLMOD_SUPERNODAL;
    common()->final_ll = 1;
  }
  Cholmod(const Cholmod&) = delete;
  Cholmod& operator=(const Cholmod&) = delete;
  ~Cholmod() {
    cholmod_free_factor(&factor_, common());
    cholmod_free_sparse(&matrix_, common());
    cholmod_finish(common());
  }

  /// Orders and analyzes a pattern; see `LinearSolver`.
  void analyze(const BlockPattern& pattern) {
    cholmod_free_factor(&factor_, common());
    cholmod_free_sparse(&matrix_, common());
    factor_ = nullptr;
    const std::size_t rows = static_cast<std::size_t>(pattern.size()) * BlockSize;
    const std::size_t entries = static_cast<std::size_t>(pattern.size() * (BlockSize * (BlockSize + 1) / 2) +
                                                         (pattern.blocks() - pattern.size()) * BlockSize * BlockSize);
    matrix_ = cholmod_allocate_sparse(rows, rows, entries, 1, 1, -1, CHOLMOD_REAL, common());
    if (matrix_ == nullptr) throw std::bad_alloc();
    fill_pattern(pattern);
    if (pattern.size() == 0) return;
    factor_ = cholmod_analyze(matrix_, common());
    if (factor_ == nullptr) throw std::bad_alloc();
  }

  /// Factorizes matrix + diag(damping); see `LinearSolver`.
  [[nodiscard]] FactorizationResult factorize(const Matrix& matrix, std::span<const double> damping = {}) {
    if (matrix.size() == 0) return {};
    fill_values(matrix, damping);
    cholmod_factorize(matrix_, factor_, common());
    if (common()->status == CHOLMOD_OUT_OF_MEMORY) throw std::bad_alloc();
    if (common()->status == CHOLMOD_OK && factor_->minor == factor_->n) return {};
    const std::size_t bad = std::min(factor_->minor, factor_->n - 1);
    return {FactorizationStatus::not_positive_definite, static_cast<const int*>(factor_->Perm)[bad] / BlockSize};
  }

  /// Overwrites the right-hand side by the solution; see `LinearSolver`.
  void solve(std::span<double> x) {
    if (x.empty()) return;
    cholmod_dense right{};
    right.nrow = right.d = right.nzmax = x.size();
    right.ncol = 1;
    right.x = x.data();
    right.xtype = CHOLMOD_REAL;
    right.dtype = CHOLMOD_DOUBLE;
    cholmod_dense* solution = cholmod_solve(CHOLMOD_A, factor_, &right, common());
    if (solution == nullptr) throw std::bad_alloc();
    std::copy_n(static_cast<const double*>(solution->x), x.size(), x.data());
    cholmod_free_dense(&solution, common());
  }

  /// Coefficients of the factor, as its analysis predicts them.
  [[nodiscard]] Offset stored_coefficients() const { return static_cast<Offset>(common_->lnz); }

 private:
  [[nodiscard]] cholmod_common* common() { return common_.get(); }

  template <class Visit>
  static void for_each_entry(const BlockPattern& pattern, Visit&& visit) {
    for (Index column = 0; column < pattern.size(); ++column) {
      for (int c = 0; c < BlockSize; ++c) {
        for (Offset k = pattern.begin(column); k < pattern.end(column); ++k) {
          for (int r = k == pattern.begin(column) ? c : 0; r < BlockSize; ++r) visit(column, c, k, r);
        }
      }
    }
  }

  void fill_pattern(const BlockPattern& pattern) {
    int* const starts = static_cast<int*>(matrix_->p);
    int* const rows = static_cast<int*>(matrix_->i);
    std::fill_n(starts, matrix_->ncol + 1, 0);
    int entry = 0;
    for_each_entry(pattern, [&](Index column, int c, Offset k, int r) {
      rows[entry++] = pattern.row(k) * BlockSize + r;
      starts[column * BlockSize + c + 1] = entry;
    });
  }

  void fill_values(const Matrix& matrix, std::span<const double> damping) {
    double* value = static_cast<double*>(matrix_->x);
    for_each_entry(matrix.pattern(), [&](Index column, int c, Offset k, int r) {
      *value = matrix.data(k)[c * BlockSize + r];
      if (!damping.empty() && r == c && k == matrix.pattern().begin(column))
        *value += damping[static_cast<std::size_t>(column) * BlockSize + static_cast<std::size_t>(c)];
      ++value;
    });
  }

  std::unique_ptr<cholmod_common> common_ = std::make_unique<cholmod_common>();
  cholmod_sparse* matrix_ = nullptr;
  cholmod_factor* factor_ = nullptr;
};
static_assert(LinearSolver<Cholmod<6>>);

/// Nested dissection by METIS, as CHOLMOD calls it: takes longer than `Amd`, and leaves a fraction of its fill where
/// many long paths are tied together, such as the scans of several sessions over the same streets.
///
/// Opt-in, as `Cholmod`. @throws std::bad_alloc, std::runtime_error if CHOLMOD was built without METIS.
/// Karypis and Kumar 1998, "A fast and high quality multilevel scheme for partitioning irregular graphs".
struct NestedDissection {
  /// An order of the pattern's columns.
  [[nodiscard]] std::vector<Index> operator()(const BlockPattern& pattern) const {
    std::vector<Index> order(static_cast<std::size_t>(pattern.size()));
    if (order.empty()) return order;
    cholmod_common common;
    cholmod_start(&common);
    common.print = 0;
    std::vector<int> starts{0}, rows;
    for (Index column = 0; column < pattern.size(); ++column) {
      for (Offset k = pattern.begin(column); k < pattern.end(column); ++k) rows.push_back(pattern.row(k));
      starts.push_back(static_cast<int>(rows.size()));
    }
    cholmod_sparse graph{};
    graph.nrow = graph.ncol = order.size();
    graph.nzmax = rows.size();
    graph.p = starts.data();
    graph.i = rows.data();
    graph.stype = -1;
    graph.itype = CHOLMOD_INT;
    graph.xtype = CHOLMOD_PATTERN;
    graph.sorted = graph.packed = 1;
    const bool found = cholmod_metis(&graph, nullptr, 0, 1, order.data(), &common) != 0;
    const bool out_of_memory = common.status == CHOLMOD_OUT_OF_MEMORY;
    cholmod_finish(&common);
    if (out_of_memory) throw std::bad_alloc();
    if (!found) throw std::runtime_error("NestedDissection: CHOLMOD was built without METIS; take Amd instead");
    return order;
  }
};
static_assert(Ordering<NestedDissection>);

}  // namespace chainslam
