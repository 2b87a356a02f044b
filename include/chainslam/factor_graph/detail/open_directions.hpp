#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <cmath>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/detail/held_components.hpp"
#include "chainslam/factor_graph/detail/normal_equations.hpp"
#include "chainslam/factor_graph/free_part.hpp"
#include "chainslam/sparse/cholesky.hpp"

namespace chainslam::detail {

/// Finds the motions that a graph's factors leave open although they tie all together, once a factorisation has failed.
///
/// Variables whose pivots are bad are held by springs as stiff as their own factors, one after another, until the
/// factorisation succeeds. What then resists a motion of such a variable by its spring alone is open; the others move
/// as the solution of a pull along it says.
template <class Graph>
class OpenDirections {
 public:
  using Group = typename Graph::Value;
  static constexpr int dof = Group::dof;
  using Matrix = Eigen::Matrix<double, dof, dof>;
  using Vector = Eigen::Matrix<double, dof, 1>;

  explicit OpenDirections(const Graph& graph) : graph_(graph), equations_(graph) {
    equations_.linearize(graph, graph.values());
    damping_.assign(static_cast<std::size_t>(equations_.gradient().size()), 0.0);
    diagonal_.resize(damping_.size());
    equations_.diagonal(diagonal_);
  }

  [[nodiscard]] std::vector<FreePart> find() {
    std::vector<FreePart> parts;
    std::vector<Index> held;
    solver_.analyze(equations_.matrix().pattern());
    for (;;) {
      const FactorizationResult result = solver_.factorize(equations_.matrix(), damping_);
      if (result.ok()) break;
      if (held.size() == most_parts || damping_[row(result.block_column)] != 0.0) return parts;
      held.push_back(result.block_column);
      for (int k = 0; k < dof; ++k) {
        const double stiffness = diagonal_[row(result.block_column) + static_cast<std::size_t>(k)];
        damping_[row(result.block_column) + static_cast<std::size_t>(k)] = stiffness > 0.0 ? stiffness : 1.0;
      }
    }
    for (const Index column : held) {
      FreePart part = find_at(column);
      if (part.directions.cols() > 0) parts.push_back(std::move(part));
    }
    return parts;
  }

 private:
  static constexpr std::size_t most_parts = 16;
  static constexpr double rounding = 1e-11;  ///< of a variable's information

  [[nodiscard]] static std::size_t row(Index column) { return static_cast<std::size_t>(Offset{column} * dof); }

  [[nodiscard]] Eigen::VectorXd solve(Index column, const Vector& right) {
    Eigen::VectorXd x = Eigen::VectorXd::Zero(equations_.gradient().size());
    x.segment<dof>(Eigen::Index{column} * dof) = right;
    solver_.solve({x.data(), static_cast<std::size_t>(x.size())});
    return x;
  }

  [[nodiscard]] FreePart find_at(Index column) {
    // In units of the springs: 1 where nothing else resists.
    const Vector root = Eigen::Map<const Vector>(damping_.data() + row(column)).cwiseSqrt();
    Matrix give;
    for (int k = 0; k < dof; ++k) {
      const Vector moved = solve(column, root[k] * Vector::Unit(k)).template segment<dof>(Eigen::Index{column} * dof);
      give.col(k) = root.cwiseProduct(moved);
    }
    const Matrix resists = Matrix::Identity() - 0.5 * (give + give.transpose());
    const auto eigen = jacobi_eigen<double, dof>(resists);
    Eigen::Index count = 0;
    while (count < dof && eigen.values[count] <= rounding) ++count;
    Eigen::MatrixXd open = root.cwiseInverse().asDiagonal() * eigen.vectors.leftCols(count);
    orthonormalize(open);
    const Key key = equations_.key(column);
    const auto [least, variables] = moving(column, open);
    FreePart part = free_part(least, variables, key, graph_.values()[key], std::move(open));
    return part;
  }

  /// The least key of the variables that move along, and how many they are.
  [[nodiscard]] std::pair<Key, Index> moving(Index column, const Eigen::MatrixXd& open) {
    const Eigen::Map<const Vector> springs(damping_.data() + row(column));
    Eigen::VectorXd moved = Eigen::VectorXd::Zero(equations_.gradient().size());
    for (Eigen::Index k = 0; k < open.cols(); ++k)
      moved += solve(column, springs.asDiagonal() * open.col(k)).cwiseAbs();
    Index count = 0;
    Key least = -1;
    for (Index other = equations_.size() - 1; other >= 0; --other) {
      if (moved.segment<dof>(Eigen::Index{other} * dof).maxCoeff() < 1e-6) continue;
      ++count;
      least = equations_.key(other);
    }
    return {least, count};
  }

  const Graph& graph_;
  NormalEquations<Graph> equations_;
  BlockCholesky<dof> solver_;
  std::vector<double> damping_;
  std::vector<double> diagonal_;
};

}  // namespace chainslam::detail
