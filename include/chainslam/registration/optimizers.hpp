#pragma once

#include <algorithm>
#include <concepts>
#include <optional>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam {

/// What an optimizer may ask of an alignment at its present pose, every pair with its match.
template <class P>
concept AlignProblem = requires(const P& problem, double damping, const Vector6d& step) {
  { problem.solve(damping) } -> std::same_as<Vector6d>;  // step of the normal equations, damping per inlier
  { problem.cost() } -> std::same_as<double>;            // at the present pose
  { problem.cost_after(step) } -> std::same_as<double>;  // with the same pairs
};

namespace detail {

/// The least that models `AlignProblem`, to check optimizers by.
struct AlignProblemArchetype {
  [[nodiscard]] Vector6d solve(double /*damping*/) const { return zeros<Vector6d>(); }
  [[nodiscard]] double cost() const { return 0; }
  [[nodiscard]] double cost_after(const Vector6d& /*step*/) const { return 0; }
};
static_assert(AlignProblem<AlignProblemArchetype>);

}  // namespace detail

/// Chooses the next step. `step(problem, damping)` may keep its `damping` from one iteration to the next, starting from
/// `initial_damping`; nothing means that no step lowers the cost.
template <class O>
concept PoseOptimizer = requires(const O& optimizer, const detail::AlignProblemArchetype& problem, double& damping) {
  { optimizer.initial_damping } -> std::convertible_to<double>;
  { optimizer.step(problem, damping) } -> std::same_as<std::optional<Vector6d>>;
};

/// Takes every step of the normal equations. Nearest points are matched again after each, so that a good guess needs no
/// more.
struct GaussNewtonStep {
  static constexpr double initial_damping = 0;  ///< undamped

  /// The Gauss-Newton step; nothing where none lowers the cost.
  template <AlignProblem Problem>
  [[nodiscard]] std::optional<Vector6d> step(const Problem& problem, double& damping) const {
    return problem.solve(damping);
  }
};
static_assert(PoseOptimizer<GaussNewtonStep>);

/// Takes only steps that lower the cost, shortening them until they do (Levenberg 1944, Marquardt 1963). Damping is
/// added to eigenvalues that are mean squared cosines, so that it means the same for metres and radians.
struct LevenbergMarquardtStep {
  double initial_damping = 1e-4;  ///< damping of the first step
  double factor = 10;             ///< between dampings
  Index max_trials = 10;          ///< within one iteration

  /// A damped step that lowers the cost; nothing where there is none.
  template <AlignProblem Problem>
  [[nodiscard]] std::optional<Vector6d> step(const Problem& problem, double& damping) const {
    constexpr double least = 1e-12;
    const double cost = problem.cost();
    for (Index trial = 0; trial < max_trials; ++trial) {
      const Vector6d step = problem.solve(damping);
      if (problem.cost_after(step) <= cost) {
        damping = std::max(damping / factor, least);
        return step;
      }
      damping = std::max(damping, least) * factor;
    }
    return std::nullopt;
  }
};
static_assert(PoseOptimizer<LevenbergMarquardtStep>);

}  // namespace chainslam
