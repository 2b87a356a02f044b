#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <concepts>
#include <limits>
#include <stdexcept>
#include <type_traits>
#include <utility>

#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/factor_graph/values.hpp"

namespace chainslam {

/// Plain least squares, less a constant.
struct LessConstant {
  double constant = 0.0;  ///< what is taken off the cost

  [[nodiscard]] double weight(double /*squared_residual*/) const { return 1.0; }  ///< always 1
  /// The squared residual less the constant.
  [[nodiscard]] double cost(double squared_residual) const { return squared_residual - constant; }
};

/// A factor some of whose rows must be zero exactly, be it against all others: a variable on a plane, two poses that
/// are one. (A variable that is known altogether is `set_fixed`.)
///
/// By the method of multipliers (augmented Lagrangian; Hestenes 1969; Nocedal and Wright 2006, section 17.3): the rows
/// have a quadratic penalty and multipliers, which are updated by what is left of them, until they are zero. `optimize`
/// and `IncrementalSmoother::converge` do so; `IncrementalSmoother::update` leaves the multipliers as they are, and the
/// rows off by the force on them times the square of the softness. The softness changes how fast the rows come to
/// zero, not the solution: a hundredth of the smallest standard deviation around makes two or three rounds; below
/// 1e-6 of the largest, rounding shows. Contradicting constraints end where their penalties balance, which the reports'
/// `violation` shows. Where a later round fails, values stay those of the last that did not, while the multipliers have
/// been updated once more.
template <Factor F>
struct Constrained {
  static_assert(F::rows != Eigen::Dynamic, "Constrained: the factor's rows are known when the program is compiled");
  static_assert(
      !RobustFactor<F> || requires(const F& f) { requires std::is_same_v<decltype(f.kernel), Trivial>; },
      "Constrained: a constraint has no robust kernel");

  using Value = typename F::Value;                ///< type of the variables
  static constexpr std::size_t arity = F::arity;  ///< number of variables
  static constexpr int rows = F::rows;            ///< rows of the residual
  /// As that of the factor: a motion of all variables from the left changes nothing.
  static constexpr bool left_invariant = [] {
    if constexpr (requires { F::left_invariant; }) return static_cast<bool>(F::left_invariant);
    return false;
  }();
  using Residual = Eigen::Matrix<double, rows, 1>;               ///< whitened residual
  using Linearized = LinearizedFactor<rows, Value::dof, arity>;  ///< what `linearize` returns

  F factor;                          ///< its hard rows divided by `softness`
  Residual hard = Residual::Zero();  ///< 1 where a row must be zero, else 0
  double softness =
      1e-4;  ///< standard deviation that stands for zero: the penalty's weight is 1/softness^2; in rows' units
  Residual multipliers = Residual::Zero();  ///< in units of the penalty: added to the residual
  LessConstant kernel{};                    ///< takes off what the multipliers alone cost

  [[nodiscard]] auto keys() const { return factor.keys(); }  ///< keys of the variables, in the order of the Jacobians
  /// The whitened residual; see `Factor`.
  [[nodiscard]] Residual residual(const Values<Value>& values) const { return factor.residual(values) + multipliers; }
  /// The whitened residual and its Jacobians; see `Factor`.
  [[nodiscard]] Linearized linearize(const Values<Value>& values) const {
    Linearized result = factor.linearize(values);
    result.residual += multipliers;
    return result;
  }

  /// How far the worst hard row is from zero, in its own units.
  [[nodiscard]] double violation(const Values<Value>& values) const {
    return softness * factor.residual(values).cwiseProduct(hard).cwiseAbs().maxCoeff();
  }
  /// Updates the multipliers by the rows' residuals at these values.
  void tighten(const Values<Value>& values) {
    set_multipliers(multipliers + factor.residual(values).cwiseProduct(hard));
  }
  /// Replaces the multipliers, one for each row.
  void set_multipliers(const Residual& next) {
    multipliers = next;
    kernel.constant = next.squaredNorm();
  }

  /// Calls visit(members...), to save or to load them.
  template <class Self, class Visit>
  static void visit_members(Self& self, Visit&& visit) {
    F::visit_members(self.factor, [&](auto&... members) {
      visit(members..., self.hard, self.softness, self.multipliers, self.kernel);
    });
  }
};

/// A factor with these standard deviations, rows as the residual's: 0 for a row that must be zero, infinity for one
/// that says nothing.
/// @param softness  as in `Constrained`.
/// @throws std::invalid_argument if a standard deviation is negative or not a number, or the softness not positive.
template <Factor F>
[[nodiscard]] Constrained<F> constrained(F factor, const Eigen::Matrix<double, F::rows, 1>& sigmas,
                                         double softness = 1e-4) {
  if (!(softness > 0.0) || !std::isfinite(softness)) throw std::invalid_argument("constrained: softness is positive");
  Constrained<F> result{.factor = std::move(factor), .softness = softness};
  Eigen::Matrix<double, F::rows, 1> root;
  for (Eigen::Index row = 0; row < F::rows; ++row) {
    if (!(sigmas[row] >= 0.0)) throw std::invalid_argument("constrained: sigmas must not be negative");
    result.hard[row] = sigmas[row] == 0.0 ? 1.0 : 0.0;
    root[row] = 1.0 / (sigmas[row] == 0.0 ? softness : sigmas[row]);
  }
  result.factor.sqrt_information = root.asDiagonal();
  return result;
}

namespace detail {

template <class F>
inline constexpr bool is_constraint = requires(F& factor, const Values<typename F::Value>& values) {
  { factor.violation(values) } -> std::same_as<double>;
  factor.tighten(values);
};

/// When the multipliers of constraints have been updated often enough.
class ConstraintRounds {
 public:
  /// @returns whether to update the multipliers and optimize once more.
  [[nodiscard]] bool more(double violation) {
    since_best_ = violation < 0.9 * best_ ? 0 : since_best_ + 1;
    best_ = std::min(best_, violation);
    return violation > enough && since_best_ < patience && ++round_ <= most;
  }

 private:
  static constexpr double enough = 1e-10;  ///< rounding where coordinates are 10^5
  static constexpr int patience = 3;
  static constexpr int most = 50;

  double best_ = std::numeric_limits<double>::infinity();
  int since_best_ = 0;
  int round_ = 0;
};

}  // namespace detail

}  // namespace chainslam
