#pragma once

#include <Eigen/Core>
#include <cmath>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/concepts.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/sparse/block_matrix.hpp"

namespace chainslam::detail {

/// J^T J and J^T r of a graph's whitened factors. Fixed variables have no rows. The pattern and each factor's places in
/// it are found once; `linearize` then allocates nothing.
template <class Graph>
class NormalEquations {
 public:
  using Group = typename Graph::Value;
  static constexpr int dof = Group::dof;
  using Matrix = BlockMatrix<dof>;

  explicit NormalEquations(const Graph& graph) : column_(static_cast<std::size_t>(graph.values().size()), -1) {
    for (Key key = 0; key < graph.values().size(); ++key) {
      if (graph.is_fixed(key)) continue;
      column_[static_cast<std::size_t>(key)] = to_index(keys_.size());
      keys_.push_back(key);
    }
    std::vector<BlockCoordinate> blocks;
    graph.for_each_factor([&](const auto& factor) {
      for_each_pair(factor.keys(), [&](Index row, Index column) { blocks.push_back({row, column}); });
    });
    matrix_ = Matrix(BlockPattern(to_index(keys_.size()), blocks));
    graph.for_each_factor([&](const auto& factor) {
      for_each_pair(factor.keys(), [&](Index row, Index column) {
        places_.push_back(*matrix_.pattern().find(std::max(row, column), std::min(row, column)));
      });
    });
    gradient_.resize(Eigen::Index{matrix_.size()} * dof);
  }

  /// Fills matrix and gradient at `values`.
  /// @returns the cost there.
  double linearize(const Graph& graph, const Values<Group>& values) {
    matrix_.set_zero();
    gradient_.setZero();
    double cost = 0.0;
    const Offset* place = places_.data();
    graph.for_each_factor([&](const auto& factor) { cost += add(factor, values, place); });
    return cost;
  }

  [[nodiscard]] const Matrix& matrix() const { return matrix_; }
  [[nodiscard]] const Eigen::VectorXd& gradient() const { return gradient_; }
  [[nodiscard]] Index size() const { return matrix_.size(); }
  /// The variable of a block column.
  [[nodiscard]] Key key(Index column) const { return keys_[static_cast<std::size_t>(column)]; }

  /// diag(J^T J)
  void diagonal(std::span<double> out) const {
    for (Index column = 0; column < matrix_.size(); ++column) {
      Eigen::Map<Eigen::Matrix<double, dof, 1>>(out.data() + Offset{column} * dof) =
          matrix_.block(matrix_.pattern().begin(column)).diagonal();
    }
  }

  /// Moves the free variables by `step`.
  void retract(const Eigen::VectorXd& step, const Values<Group>& from, Values<Group>& to) const {
    for (Index column = 0; column < matrix_.size(); ++column) {
      const Key moved = key(column);
      const typename Group::Tangent part = step.segment<dof>(Eigen::Index{column} * dof);
      to[moved] = from[moved].retract(part);
      if constexpr (requires(Group & group) { group.normalize(); }) to[moved].normalize();
    }
  }

 private:
  [[nodiscard]] Index column(Key key) const { return column_[static_cast<std::size_t>(key)]; }

  /// visit(column of a, column of b) for each pair of free keys a before or equal to b in the factor's list.
  template <class Keys, class Visit>
  void for_each_pair(const Keys& keys, Visit&& visit) const {
    for (std::size_t b = 0; b < keys.size(); ++b) {
      if (column(keys[b]) < 0) continue;
      for (std::size_t a = 0; a <= b; ++a) {
        if (column(keys[a]) >= 0) visit(column(keys[a]), column(keys[b]));
      }
    }
  }

  /// Adds one factor; `place` moves past its places.
  template <Factor F>
  double add(const F& factor, const Values<Group>& values, const Offset*& place) {
    LinearizedFactor<F::rows, dof, F::arity> linearized = factor.linearize(values);
    double cost = linearized.residual.squaredNorm();
    if constexpr (RobustFactor<F>) cost = apply_kernel(factor.kernel, cost, linearized);
    const auto keys = factor.keys();
    for (std::size_t b = 0; b < keys.size(); ++b) {
      const Index column_b = column(keys[b]);
      if (column_b < 0) continue;
      const auto transposed = by_columns(linearized.jacobians[b]);
      gradient_.segment<dof>(Eigen::Index{column_b} * dof).noalias() += transposed.lazyProduct(linearized.residual);
      for (std::size_t a = 0; a <= b; ++a) {
        const Index column_a = column(keys[a]);
        if (column_a < 0) continue;
        auto block = matrix_.block(*place++);
        if (column_b >= column_a) {
          block += transposed.lazyProduct(linearized.jacobians[a]);
        } else {
          block += transposed.lazyProduct(linearized.jacobians[a]).transpose();
        }
      }
    }
    return cost;
  }

  /// Transposed, so that the products run down columns; of fixed size as a matrix of its own.
  template <class Jacobian>
  [[nodiscard]] static auto by_columns(const Jacobian& jacobian) {
    if constexpr (Jacobian::RowsAtCompileTime == Eigen::Dynamic) {
      return jacobian.transpose();
    } else {
      return Eigen::Matrix<double, dof, Jacobian::RowsAtCompileTime>(jacobian.transpose());
    }
  }

  /// Scales residual and Jacobians by the root of the kernel's weight (iteratively reweighted least squares).
  template <class Kernel, class Linearized>
  static double apply_kernel(const Kernel& kernel, double squared, Linearized& linearized) {
    if constexpr (!std::is_same_v<Kernel, Trivial>) {
      const double scale = std::sqrt(kernel.weight(squared));
      linearized.residual *= scale;
      for (auto& jacobian : linearized.jacobians) jacobian *= scale;
    }
    return kernel.cost(squared);
  }

  std::vector<Index> column_;  ///< of each key; -1 where fixed
  std::vector<Key> keys_;      ///< of each block column
  Matrix matrix_;
  std::vector<Offset> places_;  ///< blocks of each factor in turn, in the order of `for_each_pair`
  Eigen::VectorXd gradient_;
};

}  // namespace chainslam::detail
