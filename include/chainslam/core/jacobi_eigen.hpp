#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <limits>

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

}  // namespace chainslam
