#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <span>
#include <type_traits>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/detail/linearization.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/sparse/block_matrix.hpp"
#include "chainslam/sparse/dense_kernels.hpp"

namespace chainslam::detail {

/// J^T J and J^T r of linearized factors, whatever their types. Fixed variables have no rows. The pattern and each
/// factor's places in it are found once; factors are then added in the order in which they were connected.
template <int Dof>
class NormalSystem {
 public:
  static constexpr int dof = Dof;
  using Matrix = BlockMatrix<Dof>;

  template <class IsFixed>
  NormalSystem(Index variables, IsFixed&& is_fixed) : column_(variables, -1) {
    for (Key key = 0; key < variables; ++key) {
      if (is_fixed(key)) continue;
      column_[key] = to_index(keys_.size());
      keys_.push_back(key);
    }
  }

  /// Names a factor's variables. After all of them comes `make_pattern`.
  void connect(std::span<const Key> keys) {
    for_each_pair(keys, [&](Index a, Index b) { blocks_.push_back({std::max(a, b), std::min(a, b)}); });
  }
  void make_pattern() {
    matrix_ = Matrix(BlockPattern(size(), blocks_));
    places_.reserve(static_cast<Offset>(blocks_.size()));
    for (const BlockCoordinate& block : blocks_) places_.push_back(*matrix_.pattern().find(block.row, block.column));
    blocks_ = {};
    gradient_.setZero(Eigen::Index{size()} * Dof);
  }

  void set_zero() {
    matrix_.set_zero();
    gradient_.setZero();
    next_ = 0;
  }
  /// Adds the next factor.
  /// @param numbers  as `write_linearization` writes them.
  void add(std::span<const Key> keys, Offset rows, const double* numbers) {
    const Offset stride = Dof * static_cast<Offset>(keys.size());
    const double* const residual = numbers + rows * stride;
    for (std::size_t b = 0; b < keys.size(); ++b) {
      const Index column_b = column(keys[b]);
      if (column_b < 0) continue;
      const double* const of_b = numbers + b * Dof;
      double* const gradient = gradient_.data() + Offset{column_b} * Dof;
      for (Offset row = 0; row < rows; ++row) {
        for (int k = 0; k < Dof; ++k) gradient[k] += of_b[row * stride + k] * residual[row];
      }
      for (std::size_t a = 0; a <= b; ++a) {
        const Index column_a = column(keys[a]);
        if (column_a < 0) continue;
        const double *lower = of_b, *upper = numbers + a * Dof;
        if (column_b < column_a) std::swap(lower, upper);
        add_product<Dof>(Dof, lower, stride, upper, stride, rows, matrix_.data(places_[next_++]), Dof);
      }
    }
  }

  [[nodiscard]] const Matrix& matrix() const { return matrix_; }
  [[nodiscard]] const Eigen::VectorXd& gradient() const { return gradient_; }
  [[nodiscard]] Index size() const { return to_index(keys_.size()); }
  /// The variable of a block column.
  [[nodiscard]] Key key(Index column) const { return keys_[column]; }

  /// diag(J^T J)
  void diagonal(std::span<double> out) const {
    double* to = out.data();
    for (Index column = 0; column < size(); ++column) {
      const double* const block = matrix_.data(matrix_.pattern().begin(column));
      for (int k = 0; k < Dof; ++k) *to++ = block[k * (Dof + 1)];
    }
  }

 private:
  [[nodiscard]] Index column(Key key) const { return column_[key]; }

  /// visit(column of a, column of b) for each pair of free keys a before or equal to b in the factor's list.
  template <class Visit>
  void for_each_pair(std::span<const Key> keys, Visit&& visit) const {
    for (std::size_t b = 0; b < keys.size(); ++b) {
      if (column(keys[b]) < 0) continue;
      for (std::size_t a = 0; a <= b; ++a) {
        if (column(keys[a]) >= 0) visit(column(keys[a]), column(keys[b]));
      }
    }
  }

  Table<Index> column_;  ///< of each key; -1 where fixed
  Table<Key> keys_;      ///< of each block column
  std::vector<BlockCoordinate> blocks_;
  Matrix matrix_;
  Table<Offset> places_;  ///< blocks of each factor in turn, in the order of `for_each_pair`
  Offset next_ = 0;       ///< place of the next factor
  Eigen::VectorXd gradient_;
};

/// The same of a graph's whitened factors. `linearize` allocates nothing.
template <class Graph>
class NormalEquations : public NormalSystem<Graph::Value::dof> {
 public:
  using Group = typename Graph::Value;
  using System = NormalSystem<Group::dof>;
  using System::dof;

  explicit NormalEquations(const Graph& graph)
      : System(graph.values().size(), [&](Key key) { return graph.is_fixed(key); }) {
    graph.for_each_factor([&](const auto& factor) {
      const auto keys = factor.keys();
      this->connect(std::span<const Key>(keys));
    });
    this->make_pattern();
  }

  /// Fills matrix and gradient at `values`.
  /// @returns the cost there.
  double linearize(const Graph& graph, const Values<Group>& values) {
    this->set_zero();
    double cost = 0.0;
    graph.for_each_factor([&](const auto& factor) { cost += this->add_factor(factor, values); });
    return cost;
  }

  /// Moves the free variables by `step`.
  void retract(const Eigen::VectorXd& step, const Values<Group>& from, Values<Group>& to) const {
    for (Index column = 0; column < this->size(); ++column) {
      const Key moved = this->key(column);
      const auto part = matrix_of<typename Group::Tangent>(step.data() + Offset{column} * dof);
      to[moved] = from[moved].retract(part);
      if constexpr (requires(Group & group) { group.normalize(); }) to[moved].normalize();
    }
  }

 private:
  template <Factor F>
  double add_factor(const F& factor, const Values<Group>& values) {
    const auto keys = factor.keys();
    const Offset rows = rows_of(factor);
    numbers_.resize(rows * (dof * static_cast<Offset>(keys.size()) + 1));
    const double squared = write_linearization(factor, values, Kernels::applied, numbers_.data());
    this->add(keys, rows, numbers_.data());
    if constexpr (RobustFactor<F>) return factor.kernel.cost(squared);
    return squared;
  }

  Table<double> numbers_;  ///< of the factor at hand
};

}  // namespace chainslam::detail
