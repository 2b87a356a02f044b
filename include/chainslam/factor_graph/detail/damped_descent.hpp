#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/optimize_report.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/sparse/incremental_cholesky.hpp"

namespace chainslam::detail {

/// Levenberg and Marquardt's method on the factors of an `IncrementalSmoother`, with the type of solver that it
/// has anyway. Compiled for size (`gnu::cold`): the time goes into the solver, which is not.
template <class Group, class Pools>
class DampedDescent {
 public:
  static constexpr int dof = Group::dof;
  using System = IncrementalCholesky<dof>;

  /// @param pools   the factors; they stay as they are while this lives.
  /// @param system  which terms they are, of which variables, and what is fixed.
  [[gnu::cold]] DampedDescent(const Pools& pools, const System& system)
      : pools_(pools),
        solver_({.relative_excess = 0.0,
                 .late_variables = 0,
                 .near_variables = 0,
                 .reorder_work = std::numeric_limits<double>::infinity()}) {
    for (Index variable = 0; variable < system.size(); ++variable) {
      solver_.add_variable();
      solver_.set_fixed(variable, system.is_fixed(variable));
    }
    std::vector<Index> variables;
    for (const Index term : pools.terms()) {
      variables.clear();
      for (const auto& slot : system.terms().slots(term)) variables.push_back(slot.variable);
      copies_.push_back({term, solver_.add_term(variables, system.terms().rows(term))});
    }
    diagonal_.resize(Offset{system.size()} * dof);
    damping_.resize(diagonal_.size());
  }

  /// @param values  to start from; where it succeeds, those of the least cost that was found.
  template <Executor Exec>
  [[nodiscard]] [[gnu::cold]] OptimizeReport run(const LevenbergMarquardt& method, Values<Group>& values,
                                                 const Exec& executor) {
    OptimizeReport report;
    double cost = pools_.cost(values);
    report.initial_cost = report.final_cost = cost;
    double lambda = method.initial_lambda;
    double growth = 2.0;
    Values<Group> candidate = values;
    linearize(values);
    while (std::isfinite(cost)) {
      damp(lambda);
      ++report.iterations;
      if (const FactorizationResult result = solver_.factorize(executor); !result.ok()) {
        report.status = OptimizeStatus::singular;
        report.variables = {result.block_column};
        return report;
      }
      solver_.solve(true);
      const double predicted = solver_.lowered() + lambda * retract(values, candidate);
      const double next = pools_.cost(candidate);
      const bool accepted = next <= cost;
      if (accepted) std::swap(values, candidate);
      // A strongly damped step promises little wherever it stands: it says nothing about the optimum.
      const double tolerance = method.relative_tolerance * cost + method.absolute_tolerance;
      const bool converged = predicted <= tolerance && lambda <= 1e-2;
      const bool stalled = lambda > method.max_lambda;
      const double gain = (cost - next) / predicted;
      if (accepted) cost = report.final_cost = next;
      if (converged || stalled || report.iterations >= method.max_iterations) {
        report.status = converged ? OptimizeStatus::converged
                        : stalled ? OptimizeStatus::stalled
                                  : OptimizeStatus::iteration_limit;
        return report;
      }
      solver_.begin();
      if (accepted) {
        lambda *= std::max(1.0 / 3.0, 1.0 - std::pow(2.0 * gain - 1.0, 3));
        growth = 2.0;
        linearize(values);
      } else {
        lambda *= growth;
        growth *= 2.0;
      }
    }
    report.status = OptimizeStatus::not_finite;
    return report;
  }

 private:
  struct Copy {
    Index term;  ///< of the smoother's system
    Index copy;  ///< of the one here
  };

  /// Adds the squares of `rows` rows of `dof` numbers.
  [[gnu::hot]] static void add_squares(const double* numbers, Offset stride, Index rows, double* to) {
    std::array<double, dof> sum;
    std::copy_n(to, dof, sum.begin());
    for (Index row = 0; row < rows; ++row, numbers += stride)
      for (std::size_t k = 0; k < dof; ++k) sum[k] += numbers[k] * numbers[k];
    std::copy_n(sum.begin(), dof, to);
  }

  void linearize(const Values<Group>& values) {
    diagonal_.assign(diagonal_.size(), 0.0);
    for (const Copy& at : copies_) {
      solver_.change_term(at.copy);
      const auto slots = solver_.terms().slots(at.copy);
      double* block = solver_.jacobian(at.copy);
      pools_.linearize(at.term, values, block, solver_.terms().size(at.copy));
      const Offset stride = static_cast<Offset>(slots.size()) * dof;
      for (const auto& slot : slots) {
        add_squares(block, stride, solver_.terms().rows(at.copy), diagonal_.data() + Offset{slot.variable} * dof);
        block += dof;
      }
    }
  }

  /// By a multiple of the diagonal of J^T J.
  [[gnu::cold]] void damp(double lambda) {
    for (Offset k = 0; k < diagonal_.size(); ++k) damping_[k] = lambda * diagonal_[k];
    solver_.set_damping(damping_.all());
  }

  /// Moves all by the solver's solution.
  /// @returns that step's square, weighed by the diagonal of J^T J.
  [[nodiscard]] double retract(const Values<Group>& from, Values<Group>& to) const {
    double sum = 0.0;
    for (Key key = 0; key < solver_.size(); ++key) {
      if (solver_.is_fixed(key)) continue;
      const typename Group::Tangent step = Eigen::Map<const typename Group::Tangent>(solver_.solution(key).data());
      for (int k = 0; k < dof; ++k) sum += diagonal_[Offset{key} * dof + k] * step[k] * step[k];
      to[key] = from[key].retract(step);
      if constexpr (requires(Group & group) { group.normalize(); }) to[key].normalize();
    }
    return sum;
  }

  const Pools& pools_;
  System solver_;
  Table<Copy> copies_;
  Table<double> diagonal_;  ///< of J^T J
  Table<double> damping_;
};

}  // namespace chainslam::detail
