#pragma once

#include <concepts>
#include <numeric>
#include <span>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/sparse/block_matrix.hpp"
#include "chainslam/sparse/detail/quotient_graph.hpp"

namespace chainslam {

/// Chooses the order in which a symmetric matrix's block columns are eliminated.
///
/// Laws: `order(pattern)[k]` is the block column eliminated as the k-th; the answer is a permutation of 0 .. size - 1
/// and depends on the pattern alone.
template <class O>
concept Ordering = requires(const O& order, const BlockPattern& pattern) {
  { order(pattern) } -> std::same_as<std::vector<Index>>;
};

enum class FactorizationStatus {
  success,
  not_positive_definite,  ///< a pivot is negative, not a number, or zero within rounding
};

/// How a numeric factorization went.
struct FactorizationResult {
  FactorizationStatus status = FactorizationStatus::success;  ///< how it ended
  Index block_column = -1;  ///< the block column with the bad pivot, as the caller numbers them; -1 on success

  /// Whether there is a factorization.
  [[nodiscard]] bool ok() const { return status == FactorizationStatus::success; }
};

/// Work of an update of `IncrementalCholesky`, counted: the same on every machine.
struct FactorizationWork {
  Index reordered = 0;           ///< variables whose place in the order was chosen again
  Index refactorized = 0;        ///< variables whose columns of the factor were recomputed
  Index substituted = 0;         ///< variables whose solution was recomputed
  double multiplications = 0.0;  ///< of the factorization

  /// Adds the work of another factorization.
  FactorizationWork& operator+=(const FactorizationWork& more) {
    reordered += more.reordered;
    refactorized += more.refactorized;
    substituted += more.substituted;
    multiplications += more.multiplications;
    return *this;
  }
};

/// Solves symmetric positive definite systems on one pattern for many sets of values.
///
/// Laws:
/// - `analyze(pattern)` comes first and does all that the values do not decide.
/// - `factorize(matrix, damping)` factorizes matrix + diag(damping); matrix has the analysed pattern; damping has one
///   entry for each scalar row, or none. A matrix that is not positive definite is a status, never a throw or a NaN.
/// - after a successful `factorize`, `solve(x)` replaces x by (matrix + diag(damping))^-1 x.
/// - the same calls give bit-identical results.
template <class S>
concept LinearSolver = requires(S& solver, const BlockMatrix<S::block_size>& matrix, std::span<const double> damping,
                                std::span<double> x) {
  solver.analyze(matrix.pattern());
  { solver.factorize(matrix, damping) } -> std::same_as<FactorizationResult>;
  solver.solve(x);
};

/// Eliminates the columns as they are numbered.
struct Natural {
  /// The order of the pattern: 0, 1, ...
  [[nodiscard]] std::vector<Index> operator()(const BlockPattern& pattern) const {
    std::vector<Index> order(static_cast<std::size_t>(pattern.size()));
    std::iota(order.begin(), order.end(), 0);
    return order;
  }
};
static_assert(Ordering<Natural>);

/// Approximate minimum degree on the graph of blocks: little fill at nearly linear cost.
///
/// Nodes with more than 10 sqrt(n) neighbours are eliminated last. Ties go to the node met last, so that the answer
/// depends on the pattern alone.
/// Amestoy, Davis and Duff 1996, "An approximate minimum degree ordering algorithm", with aggressive absorption.
struct Amd {
  /// An approximate minimum degree order.
  [[nodiscard]] std::vector<Index> operator()(const BlockPattern& pattern) const {
    const detail::Table<Index> order = detail::QuotientGraph(pattern).eliminate();
    return {order.begin(), order.end()};
  }
};
static_assert(Ordering<Amd>);

}  // namespace chainslam
