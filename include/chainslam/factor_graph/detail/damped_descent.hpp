#pragma once

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/batch_optimizer.hpp"
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
      solver_.set_damping(lambda);
      ++report.iterations;
      if (const FactorizationResult result = solver_.factorize(executor); !result.ok()) {
        report.status = OptimizeStatus::singular;
        report.variables.push_back(result.block_column);
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

  void linearize(const Values<Group>& values) {
    for (const Copy& at : copies_) {
      solver_.change_term(at.copy);
      pools_.linearize(at.term, values, solver_.jacobian(at.copy), solver_.terms().size(at.copy));
    }
  }

  /// Moves all by the solver's solution.
  /// @returns that step's square, weighed by the diagonal of J^T J.
  [[nodiscard]] double retract(const Values<Group>& from, Values<Group>& to) const {
    double sum = 0.0;
    for (Key key = 0; key < solver_.size(); ++key) {
      if (solver_.is_fixed(key)) continue;
      const auto step = matrix_of<typename Group::Tangent>(solver_.solution(key).data());
      for (int k = 0; k < dof; ++k) sum += solver_.diagonal(key)[k] * step[k] * step[k];
      to[key] = from[key].retract(step);
      if constexpr (requires(Group & group) { group.normalize(); }) to[key].normalize();
    }
    return sum;
  }

  const Pools& pools_;
  System solver_;
  Table<Copy> copies_;
};

}  // namespace chainslam::detail
