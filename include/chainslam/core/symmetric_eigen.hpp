#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include "chainslam/core/small_matrix.hpp"

namespace chainslam {

/// Eigenvalues, ascending, and orthonormal eigenvectors (columns) of a symmetric matrix.
template <class Scalar, int N>
struct JacobiEigen {
  Eigen::Matrix<Scalar, N, 1> values;   ///< eigenvalues, ascending
  Eigen::Matrix<Scalar, N, N> vectors;  ///< columns: the unit eigenvectors that go with them
};

/// Eigenvalues and eigenvectors of a small symmetric matrix by cyclic Jacobi rotations (Golub and Van Loan 2013,
/// section 8.5): small eigenvalues of matrices with scaled rows come out exact where tridiagonal methods lose them.
///
/// @param matrix  symmetric; only finite entries (others give NaN).
template <class Scalar, int N>
[[nodiscard]] JacobiEigen<Scalar, N> jacobi_eigen(const Eigen::Matrix<Scalar, N, N>& matrix) {
  using std::abs, std::sqrt;
  static_assert(N > 0, "jacobi_eigen: the size must be known at compile time");
  constexpr int max_sweeps = 30;  // converges quadratically: 6 to 8 are enough up to N = 10
  Eigen::Matrix<Scalar, N, N> a = matrix;
  Eigen::Matrix<Scalar, N, N> v = identity<Eigen::Matrix<Scalar, N, N>>();
  for (int sweep = 0, rotations = 1; sweep < max_sweeps && rotations > 0; ++sweep) {
    rotations = 0;
    for (int p = 0; p < N - 1; ++p) {
      for (int q = p + 1; q < N; ++q) {
        // Relative to both diagonal entries, which keeps the relative accuracy of the small eigenvalues.
        const Scalar bound = std::numeric_limits<Scalar>::epsilon() / 2 * sqrt(abs(a(p, p))) * sqrt(abs(a(q, q)));
        if (!(abs(a(p, q)) > bound)) continue;
        ++rotations;
        const Scalar slope = (a(q, q) - a(p, p)) / (2 * a(p, q));
        const Scalar t = (slope < 0 ? Scalar(-1) : Scalar(1)) / (abs(slope) + sqrt(slope * slope + 1));
        const Scalar c = 1 / sqrt(t * t + 1);
        const Scalar s = t * c;
        const auto rotate = [c, s](Scalar& x, Scalar& y) {
          const Scalar old_x = x;
          x = c * old_x - s * y;
          y = s * old_x + c * y;
        };
        for (int i = 0; i < N; ++i) rotate(a(i, p), a(i, q));
        for (int i = 0; i < N; ++i) rotate(a(p, i), a(q, i));
        a(p, q) = a(q, p) = 0;
        for (int i = 0; i < N; ++i) rotate(v(i, p), v(i, q));
      }
    }
  }
  std::array<int, N> order;
  for (int i = 0; i < N; ++i) {  // insertion sort
    int at = i;
    for (; at > 0 && a(i, i) < a(order[static_cast<std::size_t>(at - 1)], order[static_cast<std::size_t>(at - 1)]);
         --at)
      order[static_cast<std::size_t>(at)] = order[static_cast<std::size_t>(at - 1)];
    order[static_cast<std::size_t>(at)] = i;
  }
  JacobiEigen<Scalar, N> result;
  for (int i = 0; i < N; ++i) {
    const int from = order[static_cast<std::size_t>(i)];
    result.values[i] = a(from, from);
    for (int row = 0; row < N; ++row) result.vectors(row, i) = v(row, from);
  }
  return result;
}

/// Eigenvalues, ascending, and unit eigenvectors (columns, right-handed) of a symmetric 3x3 matrix.
struct SymmetricEigen3 {
  Eigen::Vector3d values;   ///< eigenvalues, ascending
  Eigen::Matrix3d vectors;  ///< columns: the unit eigenvectors that go with them
};

namespace detail {

/// The eigenvalue farthest from the two others, of a matrix with trace zero and squared norm 6 p^2. It is p times the
/// outermost root of x^3 - 3 x = det, which lies between sqrt(3) and 2 and is well conditioned there: a polynomial good
/// to 5e-5 starts Newton's method, two steps of which reach the last bit. No library function, bit-identical
/// everywhere.
[[nodiscard]] inline double isolated_eigenvalue(const Eigen::Matrix3d& m, double p) {
  const double inverse = 1.0 / p;
  const double a = m(0, 0) * inverse, b = m(1, 1) * inverse, c = m(2, 2) * inverse;
  const double d = m(1, 0) * inverse, e = m(2, 0) * inverse, f = m(2, 1) * inverse;
  const double half_det = 0.5 * (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e));
  const double h = std::min(std::abs(half_det), 1.0);
  double x = std::numbers::sqrt3 + h * (1.0 / 3.0 + h * (-0.0935 + h * (0.03658 - 0.00846 * h)));
  for (int step = 0; step < 2; ++step) x = (2.0 * x * x * x + 2.0 * h) / (3.0 * x * x - 3.0);
  return half_det >= 0 ? p * x : -p * x;
}

[[nodiscard]] inline Eigen::Matrix3d less_on_diagonal(const Eigen::Matrix3d& m, double value) {
  Eigen::Matrix3d less = m;
  for (int i = 0; i < 3; ++i) less(i, i) -= value;
  return less;
}

/// The sum of the squares of all entries.
[[nodiscard]] inline double squared_norm(const Eigen::Matrix3d& matrix) {
  const double* m = matrix.data();
  const double even = (m[0] * m[0] + m[2] * m[2]) + (m[4] * m[4] + m[6] * m[6]);
  const double odd = (m[1] * m[1] + m[3] * m[3]) + (m[5] * m[5] + m[7] * m[7]);
  return (even + odd) + m[8] * m[8];
}

/// The null direction of a symmetric matrix of rank two: the longest cross product of two of its rows.
[[nodiscard]] inline Eigen::Vector3d null_direction(const Eigen::Matrix3d& m) {
  const Eigen::Vector3d r0 = block_of<3, 1>(m, 0, 0), r1 = block_of<3, 1>(m, 0, 1), r2 = block_of<3, 1>(m, 0, 2);
  Eigen::Vector3d longest = r0.cross(r1);
  double most = longest.squaredNorm();
  for (const Eigen::Vector3d& other : {Eigen::Vector3d(r1.cross(r2)), Eigen::Vector3d(r2.cross(r0))}) {
    const double squared = other.squaredNorm();
    if (!(squared > most)) continue;
    longest = other;
    most = squared;
  }
  return scaled(1.0 / std::sqrt(most), longest);
}

/// A unit vector across v.
[[nodiscard]] inline Eigen::Vector3d unit_across(const Eigen::Vector3d& v) {
  constexpr double much_smaller = 1e-12;
  const double x = v[0], y = v[1], z = v[2];
  const bool leans = std::abs(x) > much_smaller * std::abs(z) || std::abs(y) > much_smaller * std::abs(z);
  const double first = leans ? x : z, second = y, length = std::sqrt(first * first + second * second);
  return leans ? Eigen::Vector3d(-y / length, x / length, 0) : Eigen::Vector3d(0, -z / length, y / length);
}

/// With these eigenvectors, the second turned round if that is what it takes.
[[nodiscard]] inline SymmetricEigen3 right_handed(const Eigen::Vector3d& values, const Eigen::Vector3d& first,
                                                  const Eigen::Vector3d& second, const Eigen::Vector3d& third) {
  const double side = third.dot(first.cross(second)) < 0 ? -1.0 : 1.0;
  SymmetricEigen3 result;
  result.values = values;
  set_block(result.vectors, 0, 0, first);
  set_block(result.vectors, 0, 1, scaled(side, second));
  set_block(result.vectors, 0, 2, third);
  return result;
}

}  // namespace detail

/// A fixed number of operations; errors of the order of 1e-16 times the largest eigenvalue, also for equal eigenvalues.
///
/// The eigenvector of the isolated eigenvalue comes first, then one Jacobi rotation in the plane across it gives the
/// other two, so that a nearly double eigenvalue does no harm (Eberly, A robust eigensolver for 3x3 symmetric
/// matrices).
/// @param matrix  finite; only the lower triangle is read.
[[nodiscard]] inline SymmetricEigen3 symmetric_eigen(const Eigen::Matrix3d& matrix) {
  double scale = 0;
  for (int column = 0; column < 3; ++column)
    for (int row = column; row < 3; ++row) scale = std::max(scale, std::abs(matrix(row, column)));
  if (!(scale > 4 * std::numeric_limits<double>::min())) return {zeros<Eigen::Vector3d>(), identity<Eigen::Matrix3d>()};

  const double inverse_scale = 1.0 / scale;
  const Eigen::Matrix3d relative =
      symmetric_matrix(matrix(0, 0) * inverse_scale, matrix(1, 0) * inverse_scale, matrix(2, 0) * inverse_scale,
                       matrix(1, 1) * inverse_scale, matrix(2, 1) * inverse_scale, matrix(2, 2) * inverse_scale);
  const double mean = (relative(0, 0) + relative(1, 1) + relative(2, 2)) / 3.0;
  const Eigen::Matrix3d shifted = detail::less_on_diagonal(relative, mean);
  const double p = std::sqrt(detail::squared_norm(shifted) / 6.0);
  if (!(p > 1e-16)) {
    const double value = mean * scale;
    return {Eigen::Vector3d(value, value, value), identity<Eigen::Matrix3d>()};
  }

  const double isolated = detail::isolated_eigenvalue(shifted, p);
  const Eigen::Vector3d v = detail::null_direction(detail::less_on_diagonal(shifted, isolated));
  const Eigen::Vector3d u = detail::unit_across(v);
  const Eigen::Vector3d w = v.cross(u);

  // The 2x2 matrix [a c; c b] of the map in the basis (u, w), made diagonal by one Jacobi rotation of tangent t.
  const Eigen::Vector3d scaled_u = product(relative, u), scaled_w = product(relative, w),
                        scaled_v = product(relative, v);
  const double a = u.dot(scaled_u), b = w.dot(scaled_w), c = u.dot(scaled_w);
  const double apart = b - a, root = std::sqrt(apart * apart + 4.0 * c * c);
  const double t = root > 0 ? 2.0 * c / (apart + (apart >= 0 ? root : -root)) : 0.0;
  const double cosine = 1.0 / std::sqrt(1.0 + t * t), sine = t * cosine;
  Eigen::Vector3d minor = difference_of(scaled(cosine, u), scaled(sine, w));
  Eigen::Vector3d major = sum_of(scaled(sine, u), scaled(cosine, w));
  double low = a - t * c, high = b + t * c;
  if (low > high) {
    std::swap(low, high);
    std::swap(minor, major);
  }
  const double alone = v.dot(scaled_v);
  return isolated < 0 ? detail::right_handed(scaled(scale, Eigen::Vector3d(alone, low, high)), v, minor, major)
                      : detail::right_handed(scaled(scale, Eigen::Vector3d(low, high, alone)), minor, major, v);
}

}  // namespace chainslam
