#pragma once

#include <array>
#include <cmath>
#include <cstddef>

#include "chainslam/lie/detail/rotation_series.hpp"

namespace chainslam::detail {

/// a I + b W + c W^2, W = hat(w): a matrix that commutes with rotations about w.
template <class Scalar>
struct AxialCoefficients {
  Scalar a, b, c;

  /// Coefficients of the inverse matrix, x = |w|^2. Across w the matrix is the complex number (a - c x) + i b |w|.
  [[nodiscard]] AxialCoefficients inverse(const Scalar& x) const {
    const Scalar re = a - c * x;
    const Scalar squared = re * re + b * b * x;
    return {constant<Scalar>(1) / a, -b / squared, (b * b - re * c) / (a * squared)};
  }
};

/// Mean of exp(sigma u) exp(u W) over u in [0, 1], near x = |w|^2 = sigma = 0: power series in x whose coefficients are
/// the moments M_m = mean of u^m exp(sigma u), found from the highest down by M_(m-1) = (exp(sigma) - sigma M_m) / m.
template <class Scalar>
[[nodiscard]] AxialCoefficients<Scalar> similarity_series(const Scalar& x, const Scalar& sigma) {
  using std::exp;
  constexpr std::size_t top = 2 * series_terms;
  std::array<Scalar, top + 1> moments;
  Scalar highest = constant<Scalar>(0);  // sum_n sigma^n / (n! (top + n + 1))
  for (std::size_t n = 20; n > 0; --n) {
    const auto order = static_cast<long double>(n);
    highest =
        (highest + constant<Scalar>(1 / (static_cast<long double>(top) + order + 1))) * sigma / constant<Scalar>(order);
  }
  moments[top] = highest + constant<Scalar>(1 / (static_cast<long double>(top) + 1));
  const Scalar growth = exp(sigma);
  for (std::size_t m = top; m > 0; --m)
    moments[m - 1] = (growth - sigma * moments[m]) / constant<Scalar>(static_cast<long double>(m));
  constexpr auto odd = alternating_coefficients<1, false>();
  constexpr auto even = alternating_coefficients<2, false>();
  Scalar b = constant<Scalar>(0);
  Scalar c = constant<Scalar>(0);
  for (std::size_t k = series_terms; k-- > 0;) {
    b = b * x + constant<Scalar>(odd[k]) * moments[2 * k + 1];
    c = c * x + constant<Scalar>(even[k]) * moments[2 * k + 2];
  }
  return {moments[0], b, c};
}

/// Mean of exp(sigma u) exp(u W) over u in [0, 1], W = hat(w), x = |w|^2.
template <class Scalar>
[[nodiscard]] AxialCoefficients<Scalar> similarity_coefficients(const Scalar& x, const Scalar& sigma) {
  using std::exp, std::expm1;
  const Scalar squared = x + sigma * sigma;
  if (use_series(squared)) return similarity_series(x, sigma);
  const Scalar zero = constant<Scalar>(0);
  const Scalar growth = exp(sigma);
  const Scalar a = sigma == zero ? constant<Scalar>(1) : Scalar(expm1(sigma) / sigma);
  const Scalar sine = sinc(x);
  const Scalar versine = jacobian_coefficients(x).b;
  return {a, (growth * (sigma * sine - cosine(x)) + constant<Scalar>(1)) / squared,
          (growth * (sigma * versine - sine) + a) / squared};
}

}  // namespace chainslam::detail
