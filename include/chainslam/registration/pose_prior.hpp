#pragma once

#include <array>
#include <concepts>

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

}  // namespace chainslam
