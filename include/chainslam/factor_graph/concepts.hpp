#pragma once

#include <Eigen/Core>
#include <array>
#include <concepts>
#include <span>
#include <type_traits>
#include <vector>

#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/factor_graph/values.hpp"

namespace chainslam {

/// One thing for each of a factor's variables: in an array, or in a vector where their number is known only when the
/// program runs (`arity` is `std::dynamic_extent`, `rows` then `Eigen::Dynamic`).
template <class T, std::size_t Arity>
using PerVariable = std::conditional_t<Arity == std::dynamic_extent, std::vector<T>, std::array<T, Arity>>;

/// A factor's whitened residual and its derivatives with respect to right perturbations of its variables.
template <int Rows, int Dof, std::size_t Arity>
struct LinearizedFactor {
  Eigen::Matrix<double, Rows, 1> residual;                         ///< whitened
  PerVariable<Eigen::Matrix<double, Rows, Dof>, Arity> jacobians;  ///< one for each variable, `Rows` x `Dof`
};

/// A term of the cost: the squared length of a residual that depends on `arity` variables of type `Value`.
///
/// Laws:
/// - `keys()` are `arity` different variables;
/// - `residual(values)` has `rows` rows and is whitened: its covariance is the identity;
/// - `linearize(values)` gives that residual and its derivatives with respect to d in `values[key].retract(d)`;
/// - a member `kernel`, if there is one, models `RobustCost`: the term is then `kernel.cost(squared length)`;
/// - `F::visit_members(self, visit)`, if a graph of it is saved or appended, calls visit(members...), those of type
/// `Key`
///   or `std::vector<Key>` being its keys.
template <class F>
concept Factor = requires(const F& factor, const Values<typename F::Value>& values) {
  { factor.keys() } -> std::convertible_to<PerVariable<Key, F::arity>>;
  { factor.residual(values) } -> std::convertible_to<Eigen::Matrix<double, F::rows, 1>>;
  { factor.linearize(values) } -> std::same_as<LinearizedFactor<F::rows, F::Value::dof, F::arity>>;
};

/// A factor with a robust kernel.
template <class F>
concept RobustFactor = Factor<F> && requires(const F& factor) {
  requires RobustCost<std::remove_cvref_t<decltype(factor.kernel)>>;
};

}  // namespace chainslam
