#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstddef>
#include <type_traits>

namespace chainslam::detail {

/// A constant in any scalar: exact to the last bit for floating point, through double for users' types (dual numbers).
template <class Scalar>
[[nodiscard]] constexpr Scalar constant(long double value) {
  if constexpr (std::is_floating_point_v<Scalar>)
    return static_cast<Scalar>(value);
  else
    return Scalar(static_cast<double>(value));
}

/// Terms of every series below. They are used for x = theta^2 < 1, where the first term left out is at most
/// 1 / 22! = 9e-22 (weighted: 12 / 26! < 4e-26): below the rounding of long double, so no switch can be seen.
inline constexpr std::size_t series_terms = 11;

/// (-1)^k / (2k + First)!, times k + 1 if Weighted: coefficients of x^k.
template <int First, bool Weighted, class Number = long double>
[[nodiscard]] constexpr std::array<Number, series_terms> alternating_coefficients() {
  std::array<Number, series_terms> coefficients{};
  for (std::size_t k = 0; k < series_terms; ++k) {
    long double factorial = 1;
    for (std::size_t i = 2; i <= 2 * k + First; ++i) factorial *= static_cast<long double>(i);
    const long double weight = Weighted ? static_cast<long double>(k + 1) : 1.0L;
    coefficients[k] = static_cast<Number>((k % 2 == 0 ? weight : -weight) / factorial);
  }
  return coefficients;
}

/// sum_k (-1)^k w_k x^k / (2k + First)! with w_k = 1, or k + 1 if Weighted. A function of theta^2, hence smooth at 0.
template <int First, bool Weighted, class Scalar>
[[nodiscard]] constexpr Scalar alternating_series(const Scalar& x) {
  // Rounded when compiled: to load and round a long double costs more than the sum.
  using Number = std::conditional_t<std::is_floating_point_v<Scalar>, Scalar, double>;
  constexpr std::array<Number, series_terms> coefficients = alternating_coefficients<First, Weighted, Number>();
  Scalar sum(coefficients[series_terms - 1]);
  for (std::size_t k = series_terms - 1; k-- > 0;) sum = sum * x + Scalar(coefficients[k]);
  return sum;
}

template <class Scalar>
[[nodiscard]] constexpr bool use_series(const Scalar& x) {
  return x < constant<Scalar>(1.0L);
}

// Each takes x = theta^2 >= 0.

/// cos(theta)
template <class Scalar>
[[nodiscard]] Scalar cosine(const Scalar& x) {
  using std::cos, std::sqrt;
  if (use_series(x)) return alternating_series<0, false>(x);
  return cos(sqrt(x));
}

/// sin(theta) / theta
template <class Scalar>
[[nodiscard]] Scalar sinc(const Scalar& x) {
  using std::sin, std::sqrt;
  if (use_series(x)) return alternating_series<1, false>(x);
  const Scalar theta = sqrt(x);
  return sin(theta) / theta;
}

/// Coefficients of the left Jacobian J = I + b W + c W^2 of SO(3), W = hat(w), and of its derivative: with s = w . v,
/// dJ[v] = b V + c (W V + V W) - 2 s (b_slope W + c_slope W^2).
template <class Scalar>
struct JacobianCoefficients {
  Scalar b;        ///< (1 - cos) / theta^2
  Scalar c;        ///< (theta - sin) / theta^3
  Scalar b_slope;  ///< (2 - 2 cos - theta sin) / (2 theta^4) = -b' / (2 theta)
  Scalar c_slope;  ///< (2 theta - 3 sin + theta cos) / (2 theta^5) = -c' / (2 theta)
};

template <class Scalar>
[[nodiscard]] JacobianCoefficients<Scalar> jacobian_coefficients(const Scalar& x) {
  using std::cos, std::sin, std::sqrt;
  if (use_series(x))
    return {alternating_series<2, false>(x), alternating_series<3, false>(x), alternating_series<4, true>(x),
            alternating_series<5, true>(x)};
  const Scalar theta = sqrt(x);
  const Scalar one = constant<Scalar>(1);
  const Scalar two = constant<Scalar>(2);
  const Scalar a = sin(theta) / theta;
  const Scalar b = (one - cos(theta)) / x;
  const Scalar c = (one - a) / x;
  // With 1 - cos = b x, the slopes shorten to (2 b - a) / (2 x) and (3 c - b) / (2 x).
  return {b, c, (two * b - a) / (two * x), (constant<Scalar>(3) * c - b) / (two * x)};
}

/// (1 - (theta / 2) cot(theta / 2)) / theta^2: the coefficient of W^2 in the inverse Jacobian I - W / 2 + (..) W^2.
/// Smooth up to 2 pi, where the Jacobian is singular; exact at pi, where forms that divide by sin(theta) break down.
template <class Scalar>
[[nodiscard]] Scalar inverse_jacobian_coefficient(const Scalar& x) {
  using std::sqrt, std::tan;
  if (use_series(x)) return alternating_series<4, true>(x) / alternating_series<2, false>(x);
  const Scalar half = sqrt(x) / constant<Scalar>(2);
  return (constant<Scalar>(1) - half / tan(half)) / x;
}

/// atan(y / w) / y for w > 0 and y = sqrt(y2) >= 0; tends to 1 / w at 0.
template <class Scalar>
[[nodiscard]] Scalar atan_over_argument(const Scalar& y2, const Scalar& w) {
  using std::atan2, std::sqrt;
  const Scalar ratio = y2 / (w * w);
  if (ratio < constant<Scalar>(1e-4L)) {  // the first term left out is ratio^5 / 11 < 1e-21
    Scalar sum = constant<Scalar>(1.0L / 9);
    for (const long double odd : {7.0L, 5.0L, 3.0L, 1.0L}) sum = constant<Scalar>(1 / odd) - ratio * sum;
    return sum / w;
  }
  const Scalar y = sqrt(y2);
  return atan2(y, w) / y;
}

/// The matrix of the cross product: hat(w) v = w x v.
template <class Scalar>
[[nodiscard]] Eigen::Matrix<Scalar, 3, 3> hat3(const Eigen::Matrix<Scalar, 3, 1>& w) {
  const Scalar zero = constant<Scalar>(0);
  Eigen::Matrix<Scalar, 3, 3> matrix;
  matrix(0, 0) = matrix(1, 1) = matrix(2, 2) = zero;
  matrix(2, 1) = w[0], matrix(1, 2) = -w[0];
  matrix(0, 2) = w[1], matrix(2, 0) = -w[1];
  matrix(1, 0) = w[2], matrix(0, 1) = -w[2];
  return matrix;
}

/// hat(a) hat(b) = b a' - (a . b) I.
template <class Scalar>
[[nodiscard]] Eigen::Matrix<Scalar, 3, 3> hat_product(const Eigen::Matrix<Scalar, 3, 1>& a,
                                                      const Eigen::Matrix<Scalar, 3, 1>& b) {
  const Scalar dot = a.dot(b);
  Eigen::Matrix<Scalar, 3, 3> product;
#pragma GCC unroll 3
  for (int j = 0; j < 3; ++j) {
#pragma GCC unroll 3
    for (int i = 0; i < 3; ++i) product(i, j) = b[i] * a[j];
    product(j, j) -= dot;
  }
  return product;
}

/// one I + b W + c W^2 with W = hat(w): a matrix that commutes with rotations about w.
template <class Scalar>
[[nodiscard]] Eigen::Matrix<Scalar, 3, 3> axial_matrix(const Scalar& one, const Scalar& b, const Scalar& c,
                                                       const Eigen::Matrix<Scalar, 3, 1>& w) {
  const Scalar c_x = c * w[0], c_y = c * w[1], c_z = c * w[2];
  const Scalar xx = c_x * w[0], yy = c_y * w[1], zz = c_z * w[2];
  const Scalar xy = c_x * w[1], xz = c_x * w[2], yz = c_y * w[2];
  const Scalar b_x = b * w[0], b_y = b * w[1], b_z = b * w[2];
  Eigen::Matrix<Scalar, 3, 3> matrix;
  matrix(0, 0) = one - (yy + zz), matrix(1, 1) = one - (xx + zz), matrix(2, 2) = one - (xx + yy);
  matrix(2, 1) = yz + b_x, matrix(1, 2) = yz - b_x;
  matrix(0, 2) = xz + b_y, matrix(2, 0) = xz - b_y;
  matrix(1, 0) = xy + b_z, matrix(0, 1) = xy - b_z;
  return matrix;
}

}  // namespace chainslam::detail
