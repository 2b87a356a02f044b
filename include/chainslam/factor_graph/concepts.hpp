#pragma once

#include <Eigen/Core>
#include <array>
#include <concepts>

#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/factor_graph/values.hpp"

namespace chainslam {

/// A factor's whitened residual and its derivatives with respect to right perturbations of its variables.
template <int Rows, int Dof, std::size_t Arity>
struct LinearizedFactor {
  Eigen::Matrix<double, Rows, 1> residual;
  std::array<Eigen::Matrix<double, Rows, Dof>, Arity> jacobians;
};

/// A term of the cost: the squared length of a residual that depends on `arity` variables of type `Value`.
///
/// Laws:
/// - `keys()` are `arity` different variables;
/// - `residual(values)` has `rows` rows and is whitened: its covariance is the identity;
/// - `linearize(values)` gives that residual and its derivatives with respect to d in `values[key].retract(d)`;
/// - a member `kernel`, if there is one, models `RobustCost`: the term is then `kernel.cost(squared length)`.
template <class F>
concept Factor = requires(const F& factor, const Values<typename F::Value>& values) {
  { factor.keys() } -> std::same_as<std::array<Key, F::arity>>;
  { factor.residual(values) } -> std::convertible_to<Eigen::Matrix<double, F::rows, 1>>;
  { factor.linearize(values) } -> std::same_as<LinearizedFactor<F::rows, F::Value::dof, F::arity>>;
};

/// A factor with a robust kernel.
template <class F>
concept RobustFactor = Factor<F> && requires(const F& factor) {
  requires RobustCost<std::remove_cvref_t<decltype(factor.kernel)>>;
};

}  // namespace chainslam
