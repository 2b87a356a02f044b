#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <span>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/core/robust_kernels.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/factor_graph/values.hpp"

// What a factor is to a linear system, whatever its type: some numbers. All that is done with them is then compiled
// once, and not for each type.

namespace chainslam::detail {

/// Whether factors of this type hold their variables in place, as those on one variable do.
template <class F>
inline constexpr bool holds_in_place = [] {
  if constexpr (requires { F::holds_in_place; }) return static_cast<bool>(F::holds_in_place);
  return F::arity == 1;
}();

/// Whether a motion of all its variables from the left changes nothing for a factor, as its member says.
template <class F>
inline constexpr bool is_left_invariant = [] {
  if constexpr (requires { F::left_invariant; }) return static_cast<bool>(F::left_invariant);
  return false;
}();

/// Whether a factor's weight can be set: its kernel, if it has one, does not, nor has it parts that are not scaled.
template <class F>
inline constexpr bool is_weighable = [] {
  if constexpr (F::arity == std::dynamic_extent || !requires(F & factor) { factor.sqrt_information *= 1.0; })
    return false;
  else if constexpr (requires(const F& factor) { factor.kernel; })
    return std::is_same_v<std::remove_cvref_t<decltype(std::declval<const F&>().kernel)>, Trivial>;
  return true;
}();

/// Whether robust kernels scale what their factors say.
enum class Kernels { applied, left_out };

/// Rows of a factor's residual.
template <Factor F>
[[nodiscard]] Index rows_of(const F& factor) {
  if constexpr (F::rows == Eigen::Dynamic) return to_index(factor.offset.size());
  return F::rows;
}

/// Writes the numbers of `write_linearization`, without a kernel.
/// @returns the squared residual.
template <int Rows, int Dof, std::size_t Arity>
[[gnu::noinline]] double write_numbers(const LinearizedFactor<Rows, Dof, Arity>& linearized, double* numbers) {
  const Offset rows = Rows == Eigen::Dynamic ? linearized.residual.size() : Offset{Rows};
  const auto stride = Dof * static_cast<Offset>(linearized.jacobians.size());
  double* to = numbers;
  for (const auto& jacobian : linearized.jacobians) {
    const double* from = jacobian.data();
    for (Offset k = 0; k < Dof; ++k, ++to) {
      for (Offset row = 0; row < rows; ++row) to[row * stride] = *from++;
    }
  }
  const double* const residual = linearized.residual.data();
  double squared = 0.0;
  for (Offset row = 0; row < rows; ++row) {
    numbers[rows * stride + row] = residual[row];
    squared += residual[row] * residual[row];
  }
  return squared;
}

/// Writes a factor's Jacobian, transposed and column-major (`F::Value::dof` rows for each of its variables, a column
/// for each residual row), and its residual behind that.
/// @returns the squared residual, without the kernel.
template <Factor F>
double write_linearization(const F& factor, const Values<typename F::Value>& values, Kernels kernels, double* numbers) {
  const LinearizedFactor<F::rows, F::Value::dof, F::arity> linearized = factor.linearize(values);
  const double squared = write_numbers(linearized, numbers);
  if constexpr (RobustFactor<F>) {
    using Kernel = std::remove_cvref_t<decltype(factor.kernel)>;
    if (!std::is_same_v<Kernel, Trivial> && kernels == Kernels::applied) {
      const Offset rows = linearized.residual.size();
      const auto stride = F::Value::dof * static_cast<Offset>(linearized.jacobians.size());
      const double scale = std::sqrt(factor.kernel.weight(squared));
      for (Offset k = 0; k < rows * (stride + 1); ++k) numbers[k] *= scale;
    }
  }
  return squared;
}

/// Those numbers in memory of their own.
template <Factor F>
[[nodiscard]] std::vector<double> linearization(const F& factor, const Values<typename F::Value>& values,
                                                Kernels kernels) {
  const std::size_t columns = F::Value::dof * factor.keys().size() + 1;
  std::vector<double> numbers(columns * static_cast<std::size_t>(rows_of(factor)));
  write_linearization(factor, values, kernels, numbers.data());
  return numbers;
}

/// Writes a factor's residual, scaled by the root of its kernel's weight.
template <Factor F>
void write_residual(const F& factor, const Values<typename F::Value>& values, double* residual) {
  const Eigen::Matrix<double, F::rows, 1> plain = factor.residual(values);
  double scale = 1.0;
  if constexpr (RobustFactor<F>) scale = std::sqrt(factor.kernel.weight(plain.squaredNorm()));
  for (Eigen::Index row = 0; row < plain.size(); ++row) residual[row] = scale * plain.data()[row];
}

template <Factor F>
[[nodiscard]] double robust_cost(const F& factor, const Values<typename F::Value>& values) {
  const double squared = factor.residual(values).squaredNorm();
  if constexpr (RobustFactor<F>) return factor.kernel.cost(squared);
  return squared;
}

}  // namespace chainslam::detail
