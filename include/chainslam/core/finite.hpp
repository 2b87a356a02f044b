#pragma once

#include <Eigen/Core>
#include <bit>
#include <concepts>
#include <cstdint>

namespace chainslam {

/// True for numbers, false for NaN and infinities. Reads the exponent's bits: under `-ffast-math` a compiler takes
/// `std::isfinite` to be true always.
[[nodiscard]] constexpr bool is_finite(float value) {
  constexpr std::uint32_t exponent = 0x7f80'0000;
  return (std::bit_cast<std::uint32_t>(value) & exponent) != exponent;
}

/// @copydoc is_finite(float)
[[nodiscard]] constexpr bool is_finite(double value) {
  constexpr std::uint64_t exponent = 0x7ff0'0000'0000'0000;
  return (std::bit_cast<std::uint64_t>(value) & exponent) != exponent;
}

/// True if all coefficients are finite.
template <class Derived>
  requires std::same_as<typename Derived::Scalar, float> || std::same_as<typename Derived::Scalar, double>
[[nodiscard]] bool is_finite(const Eigen::DenseBase<Derived>& coefficients) {
  for (Eigen::Index column = 0; column < coefficients.cols(); ++column)
    for (Eigen::Index row = 0; row < coefficients.rows(); ++row)
      if (!is_finite(coefficients.derived().coeff(row, column))) return false;
  return true;
}

}  // namespace chainslam
