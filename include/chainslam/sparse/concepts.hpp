#pragma once

#include <concepts>
#include <span>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/sparse/block_matrix.hpp"

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

}  // namespace chainslam
