#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <memory>
#include <span>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/values.hpp"
#include "chainslam/sparse/block_matrix.hpp"
#include "chainslam/sparse/incremental_cholesky.hpp"

namespace chainslam::detail {

/// Linearized factors whose variables are held by springs, on the solver that an `IncrementalSmoother` has anyway. A
/// spring is a term of its own, and a pull its residual. Cold: it comes once, before a failure is reported.
template <int Dof>
class SpringedTerms {
 public:
  static constexpr int dof = Dof;

  void add_variable(bool fixed) {
    terms_.add_variable();
    fixed_.push_back(fixed ? 1 : 0);
  }
  /// @returns where the factor's numbers are to be written, as `write_linearization` does.
  [[nodiscard]] double* add(std::span<const Key> keys, Index rows) { return terms_.jacobian(terms_.add(keys, rows)); }

  [[nodiscard]] Index size() const { return to_index(fixed_.size()); }
  [[nodiscard]] Key key(Index column) const { return column; }
  /// diag(J^T J), without springs.
  void diagonal(std::span<double> out) const {
    for (Index term = 0; term < terms_.count(); ++term) {
      const double* number = terms_.jacobian(term);
      for (Index row = 0; row < terms_.rows(term); ++row) {
        for (const auto& slot : terms_.slots(term)) {
          double* const to = out.data() + Offset{slot.variable} * Dof;
          for (int k = 0; k < Dof; ++k, ++number) to[k] += *number * *number;
        }
      }
    }
  }

  /// @param stiffness  of the springs: of a variable's rows, all are positive or all zero.
  [[nodiscard]] [[gnu::cold]] FactorizationResult factorize(std::span<const double> stiffness) {
    solver_ = std::make_unique<Solver>(typename Solver::Options{.relative_excess = 0.0});
    Solver& solver = *solver_;
    springs_.assign(size(), -1);
    pulled_ = -1;
    for (Index variable = 0; variable < size(); ++variable) {
      solver.add_variable();
      solver.set_fixed(variable, fixed_[variable] != 0);
    }
    std::vector<Index> variables;
    for (Index term = 0; term < terms_.count(); ++term) {
      variables.clear();
      for (const auto& slot : terms_.slots(term)) variables.push_back(slot.variable);
      const Index copy = solver.add_term(variables, terms_.rows(term));
      std::copy(terms_.jacobian(term), terms_.residual(term), solver.jacobian(copy));
    }
    for (Index variable = 0; variable < size(); ++variable) {
      const double* const of_variable = stiffness.data() + Offset{variable} * Dof;
      if (of_variable[0] == 0.0) continue;
      springs_[variable] = solver.add_term(std::array<Index, 1>{variable}, Dof);
      for (int k = 0; k < Dof; ++k) solver.jacobian(springs_[variable])[k * (Dof + 1)] = std::sqrt(of_variable[k]);
    }
    return solver.factorize();
  }

  /// How all move where a variable with springs is pulled, after a successful `factorize`.
  [[nodiscard]] [[gnu::cold]] std::vector<double> solve(Index variable, const double* pull) {
    Solver& solver = *solver_;
    solver.begin();
    if (pulled_ != -1) {
      solver.change_term(springs_[pulled_]);
      std::fill_n(solver.residual(springs_[pulled_]), Dof, 0.0);
    }
    const Index spring = springs_[variable];
    if (pulled_ != variable) solver.change_term(spring);
    for (int k = 0; k < Dof; ++k) solver.residual(spring)[k] = -pull[k] / solver.jacobian(spring)[k * (Dof + 1)];
    pulled_ = variable;
    static_cast<void>(solver.factorize());
    solver.solve(true);
    std::vector<double> x(static_cast<std::size_t>(Offset{size()} * Dof));
    for (Index other = 0; other < size(); ++other)
      std::copy_n(solver.solution(other).data(), Dof, x.data() + Offset{other} * Dof);
    return x;
  }

 private:
  using Solver = IncrementalCholesky<Dof>;

  BlockTerms<Dof> terms_;
  Table<char> fixed_;
  std::unique_ptr<Solver> solver_;
  Table<Index> springs_;  ///< of each variable: its springs' term, -1 if it has none
  Index pulled_ = -1;
};

}  // namespace chainslam::detail
