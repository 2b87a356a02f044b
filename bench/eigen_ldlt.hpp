#pragma once

#include <Eigen/OrderingMethods>
#include <Eigen/SparseCholesky>
#include <Eigen/SparseCore>
#include <algorithm>
#include <span>
#include <vector>

#include "chainslam/sparse/block_matrix.hpp"
#include "chainslam/sparse/concepts.hpp"

namespace chainslam::bench {

/// `LinearSolver` by Eigen's simplicial LDL^T with its AMD.
template <int BlockSize>
class EigenLdlt {
 public:
  static constexpr int block_size = BlockSize;

  void analyze(const BlockPattern& pattern) {
    std::vector<Eigen::Triplet<double>> entries;
    for_each_entry(pattern, [&](Eigen::Index row, Eigen::Index column, const auto&...) {
      entries.emplace_back(static_cast<int>(row), static_cast<int>(column), 1.0);
    });
    const Eigen::Index rows = Eigen::Index{pattern.size()} * BlockSize;
    matrix_.resize(rows, rows);
    matrix_.setFromTriplets(entries.begin(), entries.end());
    solver_.analyzePattern(matrix_);
  }

  [[nodiscard]] FactorizationResult factorize(const BlockMatrix<BlockSize>& matrix,
                                              std::span<const double> damping = {}) {
    double* value = matrix_.valuePtr();
    for_each_entry(matrix.pattern(), [&](Eigen::Index row, Eigen::Index column, Offset block, int r, int c) {
      *value = matrix.data(block)[c * BlockSize + r];
      if (row == column && !damping.empty()) *value += damping[static_cast<std::size_t>(row)];
      ++value;
    });
    solver_.factorize(matrix_);
    if (solver_.info() == Eigen::Success) return {};
    return {FactorizationStatus::not_positive_definite, 0};
  }

  void solve(std::span<double> x) {
    Eigen::Map<Eigen::VectorXd> right(x.data(), static_cast<Eigen::Index>(x.size()));
    right = solver_.solve(right).eval();
  }

 private:
  template <class Visit>
  static void for_each_entry(const BlockPattern& pattern, Visit&& visit) {
    for (Index column = 0; column < pattern.size(); ++column) {
      for (int c = 0; c < BlockSize; ++c) {
        for (Offset k = pattern.begin(column); k < pattern.end(column); ++k) {
          for (int r = k == pattern.begin(column) ? c : 0; r < BlockSize; ++r)
            visit(Eigen::Index{pattern.row(k)} * BlockSize + r, Eigen::Index{column} * BlockSize + c, k, r, c);
        }
      }
    }
  }

  Eigen::SparseMatrix<double> matrix_;
  Eigen::SimplicialLDLT<Eigen::SparseMatrix<double>> solver_;
};
static_assert(LinearSolver<EigenLdlt<6>>);

}  // namespace chainslam::bench
