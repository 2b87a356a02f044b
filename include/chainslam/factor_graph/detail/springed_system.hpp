#pragma once

#include <algorithm>
#include <cstddef>
#include <span>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/detail/normal_equations.hpp"
#include "chainslam/sparse/cholesky.hpp"

namespace chainslam::detail {

/// Normal equations whose variables are held by springs.
template <int Dof>
class SpringedSystem {
 public:
  static constexpr int dof = Dof;

  explicit SpringedSystem(const NormalSystem<Dof>& system) : system_(system) {
    solver_.analyze(system.matrix().pattern());
  }

  [[nodiscard]] Index size() const { return system_.size(); }
  /// The variable of a block column.
  [[nodiscard]] Key key(Index column) const { return system_.key(column); }
  /// diag(J^T J), without springs.
  void diagonal(std::span<double> out) const { system_.diagonal(out); }
  /// @param stiffness  of the springs, one entry for each scalar row.
  [[nodiscard]] FactorizationResult factorize(std::span<const double> stiffness) {
    return solver_.factorize(system_.matrix(), stiffness);
  }
  /// How all move where one block column is pulled, after a successful `factorize`.
  [[nodiscard]] std::vector<double> solve(Index column, const double* pull) {
    std::vector<double> x(static_cast<std::size_t>(system_.gradient().size()), 0.0);
    std::copy_n(pull, Dof, x.data() + Offset{column} * Dof);
    solver_.solve(x);
    return x;
  }

 private:
  const NormalSystem<Dof>& system_;
  BlockCholesky<Dof> solver_;
};

}  // namespace chainslam::detail
