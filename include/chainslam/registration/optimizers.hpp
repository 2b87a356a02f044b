#pragma once

#include <algorithm>
#include <array>
#include <concepts>
#include <optional>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// What a prior adds at a pose, in the unit of the pairs' squared residuals; tangent of a right perturbation of
/// T_target_source.
struct PriorTerms {
  Matrix6d hessian = zeros<Matrix6d>();   ///< 6 x 6, tangent [translation; rotation]
  Vector6d gradient = zeros<Vector6d>();  ///< half the derivative of the cost
  double cost = 0;                        ///< squared error
};

/// What is known of T_target_source beside the points.
template <class P>
concept AlignPrior = requires(const P& prior, const SE3d& T_target_source) {
  { prior.evaluate(T_target_source) } -> std::same_as<PriorTerms>;
};

/// Nothing is known beforehand.
struct NoPrior {
  [[nodiscard]] PriorTerms evaluate(const SE3d& /*T_target_source*/) const { return {}; }  ///< nothing
};
static_assert(AlignPrior<NoPrior>);

/// A pose with its information, as odometry or an IMU gives it.
struct PosePrior {
  SE3d T_target_source{};  ///< the expected pose
  Matrix6d information =
      zeros<Matrix6d>();  ///< 1/m^2, 1/rad^2, tangent [translation; rotation] of a right perturbation
  /// How far a pair's residual errs, metres: weighs pairs against the prior. Neighbouring points err together; for
  /// every hundred that do, take ten times the sensor's noise.
  double pair_deviation = 0.1;

  /// For double alone; a template, so that alignments without a prior do not compile it.
  template <std::same_as<double> Scalar>
  [[nodiscard]] PriorTerms evaluate(const SE3<Scalar>& T) const {
    const double unit = pair_deviation * pair_deviation;
    const Vector6d off = T_target_source.local(T);
    const Matrix6d Jt = transposed(SE3d::left_jacobian_inverse(-off));
    const Vector6d pull = product(information, off);
    return {.hessian = unit * product_transposed(product(Jt, information), Jt),
            .gradient = unit * product(Jt, pull),
            .cost = unit * off.dot(pull)};
  }
};
static_assert(AlignPrior<PosePrior>);

/// Which motions of the source are solved for: shifts of its origin along the target's axes and turns about them. A
/// vehicle on known ground leaves z, roll and pitch out.
struct DegreesOfFreedom {
  bool x = true;      ///< shifts along the target's x axis
  bool y = true;      ///< along its y axis
  bool z = true;      ///< along its z axis
  bool roll = true;   ///< turns about its x axis
  bool pitch = true;  ///< about its y axis
  bool yaw = true;    ///< about its z axis

  /// As flags, in the order of a tangent.
  [[nodiscard]] std::array<bool, 6> mask() const { return {x, y, z, roll, pitch, yaw}; }
  [[nodiscard]] bool all() const { return x && y && z && roll && pitch && yaw; }  ///< whether none is held
};

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
