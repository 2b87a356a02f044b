#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <type_traits>

namespace chainslam {

// Sums, products, transposes and blocks of small matrices of fixed size: one function for each shape, where Eigen's
// expressions make dozens of types, which take a hundred times as long to compile. Column by column; sums run in order
// of the inner index, whatever the instruction set.

/// A matrix of the given type, all zeros.
template <class Matrix>
[[nodiscard]] Matrix zeros() {
  Matrix A;
  for (int i = 0; i < Matrix::SizeAtCompileTime; ++i) A.data()[i] = typename Matrix::Scalar(0);
  return A;
}

/// The identity of the given square type.
template <class Matrix>
[[nodiscard]] Matrix identity() {
  Matrix I = zeros<Matrix>();
  for (int i = 0; i < Matrix::RowsAtCompileTime; ++i)
    I.data()[i * (Matrix::RowsAtCompileTime + 1)] = typename Matrix::Scalar(1);
  return I;
}

/// The matrix of these numbers, column by column.
template <class Matrix>
[[nodiscard]] Matrix matrix_of(const typename Matrix::Scalar* numbers) {
  Matrix A;
  for (int i = 0; i < Matrix::SizeAtCompileTime; ++i) A.data()[i] = numbers[i];
  return A;
}

/// A with numbers of another type.
template <class To, class Scalar, int Rows, int Columns>
[[nodiscard]] Eigen::Matrix<To, Rows, Columns> converted(const Eigen::Matrix<Scalar, Rows, Columns>& A) {
  Eigen::Matrix<To, Rows, Columns> B;
#pragma GCC unroll 6
  for (int i = 0; i < Rows * Columns; ++i) B.data()[i] = static_cast<To>(A.data()[i]);
  return B;
}

/// A + B
template <class Scalar, int Rows, int Columns>
[[nodiscard]] Eigen::Matrix<Scalar, Rows, Columns> sum_of(const Eigen::Matrix<Scalar, Rows, Columns>& A,
                                                          const Eigen::Matrix<Scalar, Rows, Columns>& B) {
  Eigen::Matrix<Scalar, Rows, Columns> C;
#pragma GCC unroll 6
  for (int i = 0; i < Rows * Columns; ++i) C.data()[i] = A.data()[i] + B.data()[i];
  return C;
}

/// A - B
template <class Scalar, int Rows, int Columns>
[[nodiscard]] Eigen::Matrix<Scalar, Rows, Columns> difference_of(const Eigen::Matrix<Scalar, Rows, Columns>& A,
                                                                 const Eigen::Matrix<Scalar, Rows, Columns>& B) {
  Eigen::Matrix<Scalar, Rows, Columns> C;
#pragma GCC unroll 6
  for (int i = 0; i < Rows * Columns; ++i) C.data()[i] = A.data()[i] - B.data()[i];
  return C;
}

/// -A
template <class Scalar, int Rows, int Columns>
[[nodiscard]] Eigen::Matrix<Scalar, Rows, Columns> negative(const Eigen::Matrix<Scalar, Rows, Columns>& A) {
  Eigen::Matrix<Scalar, Rows, Columns> B;
#pragma GCC unroll 6
  for (int i = 0; i < Rows * Columns; ++i) B.data()[i] = -A.data()[i];
  return B;
}

/// factor A
template <class Scalar, int Rows, int Columns>
[[nodiscard]] Eigen::Matrix<Scalar, Rows, Columns> scaled(const std::type_identity_t<Scalar>& factor,
                                                          const Eigen::Matrix<Scalar, Rows, Columns>& A) {
  Eigen::Matrix<Scalar, Rows, Columns> B;
#pragma GCC unroll 6
  for (int i = 0; i < Rows * Columns; ++i) B.data()[i] = factor * A.data()[i];
  return B;
}

/// A / divisor
template <class Scalar, int Rows, int Columns>
[[nodiscard]] Eigen::Matrix<Scalar, Rows, Columns> divided(const Eigen::Matrix<Scalar, Rows, Columns>& A,
                                                           const std::type_identity_t<Scalar>& divisor) {
  Eigen::Matrix<Scalar, Rows, Columns> B;
#pragma GCC unroll 6
  for (int i = 0; i < Rows * Columns; ++i) B.data()[i] = A.data()[i] / divisor;
  return B;
}

/// A B
template <class Scalar, int Rows, int Inner, int Columns>
[[nodiscard]] Eigen::Matrix<Scalar, Rows, Columns> product(const Eigen::Matrix<Scalar, Rows, Inner>& A,
                                                           const Eigen::Matrix<Scalar, Inner, Columns>& B) {
  Eigen::Matrix<Scalar, Rows, Columns> C;
  const Scalar *a = A.data(), *b = B.data();
  Scalar* c = C.data();
  if constexpr (Rows <= 3) {  // unrolled as a whole: one sum after another, all in registers
#pragma GCC unroll 6
    for (int j = 0; j < Columns; ++j) {
#pragma GCC unroll 3
      for (int i = 0; i < Rows; ++i) {
        Scalar sum = a[i] * b[j * Inner];
#pragma GCC unroll 6
        for (int k = 1; k < Inner; ++k) sum += a[i + k * Rows] * b[k + j * Inner];
        c[i + j * Rows] = sum;
      }
    }
  } else {  // a column of sums at a time, which vectorizes
    for (int j = 0; j < Columns; ++j) {
      Scalar column[Rows];
#pragma GCC unroll 6
      for (int i = 0; i < Rows; ++i) column[i] = a[i] * b[j * Inner];
#pragma GCC unroll 6
      for (int k = 1; k < Inner; ++k) {
#pragma GCC unroll 6
        for (int i = 0; i < Rows; ++i) column[i] += a[i + k * Rows] * b[k + j * Inner];
      }
#pragma GCC unroll 6
      for (int i = 0; i < Rows; ++i) c[i + j * Rows] = column[i];
    }
  }
  return C;
}

/// A^T
template <class Scalar, int Rows, int Columns>
[[nodiscard]] Eigen::Matrix<Scalar, Columns, Rows> transposed(const Eigen::Matrix<Scalar, Rows, Columns>& A) {
  Eigen::Matrix<Scalar, Columns, Rows> T;
#pragma GCC unroll 6
  for (int j = 0; j < Columns; ++j) {
#pragma GCC unroll 6
    for (int i = 0; i < Rows; ++i) T.data()[j + i * Columns] = A.data()[i + j * Rows];
  }
  return T;
}

/// A B^T
template <class Scalar, int Rows, int Inner, int Columns>
[[nodiscard]] Eigen::Matrix<Scalar, Rows, Columns> product_transposed(const Eigen::Matrix<Scalar, Rows, Inner>& A,
                                                                      const Eigen::Matrix<Scalar, Columns, Inner>& B) {
  return product(A, transposed(B));
}

/// A^T B
template <class Scalar, int Rows, int Inner, int Columns>
[[nodiscard]] Eigen::Matrix<Scalar, Rows, Columns> transposed_product(const Eigen::Matrix<Scalar, Inner, Rows>& A,
                                                                      const Eigen::Matrix<Scalar, Inner, Columns>& B) {
  return product(transposed(A), B);
}

/// The block of A whose first entry is A(row, column).
template <int BlockRows, int BlockColumns, class Scalar, int Rows, int Columns>
[[nodiscard]] Eigen::Matrix<Scalar, BlockRows, BlockColumns> block_of(const Eigen::Matrix<Scalar, Rows, Columns>& A,
                                                                      int row, int column) {
  Eigen::Matrix<Scalar, BlockRows, BlockColumns> block;
#pragma GCC unroll 6
  for (int j = 0; j < BlockColumns; ++j) {
#pragma GCC unroll 6
    for (int i = 0; i < BlockRows; ++i) block.data()[i + j * BlockRows] = A.data()[row + i + (column + j) * Rows];
  }
  return block;
}

/// Overwrites the block of A whose first entry is A(row, column).
template <class Scalar, int Rows, int Columns, int BlockRows, int BlockColumns>
void set_block(Eigen::Matrix<Scalar, Rows, Columns>& A, int row, int column,
               const Eigen::Matrix<Scalar, BlockRows, BlockColumns>& block) {
#pragma GCC unroll 6
  for (int j = 0; j < BlockColumns; ++j) {
#pragma GCC unroll 6
    for (int i = 0; i < BlockRows; ++i) A.data()[row + i + (column + j) * Rows] = block.data()[i + j * BlockRows];
  }
}

/// The symmetric matrix of which this is the upper triangle, row by row.
template <class Scalar>
[[nodiscard]] Eigen::Matrix<Scalar, 3, 3> symmetric_matrix(Scalar xx, Scalar xy, Scalar xz, Scalar yy, Scalar yz,
                                                           Scalar zz) {
  Eigen::Matrix<Scalar, 3, 3> S;
  Scalar* s = S.data();
  s[0] = xx;
  s[4] = yy;
  s[8] = zz;
  s[1] = s[3] = xy;
  s[2] = s[6] = xz;
  s[5] = s[7] = yz;
  return S;
}

/// |a - b|^2, summed in the order of the axes, as all searches form it.
template <int Dim, class Scalar>
[[nodiscard]] Scalar squared_distance(const Scalar* a, const Scalar* b) {
  Scalar sum = 0;
  for (int axis = 0; axis < Dim; ++axis) sum += (a[axis] - b[axis]) * (a[axis] - b[axis]);
  return sum;
}

// Square matrices of a dozen to some dozen rows, such as a filter's. All there is to compute are sums of weighted
// columns, which vectorize: one kernel, that compiles fast, instead of Eigen's many.

/// The sum of the first `count` columns of A, column k times weights[k * stride]. Skips columns of zero weight, of
/// which a transition has many.
///
/// A call, not inlined: with -O3 and AVX-512, g++ 12 makes an inlined sum of 10 to 16 rows skip columns that are not
/// zero.
template <class Scalar, int N>
[[nodiscard, gnu::noinline]] Eigen::Matrix<Scalar, N, 1> weighted_columns(const Eigen::Matrix<Scalar, N, N>& A,
                                                                          int count, const Scalar* weights,
                                                                          int stride) {
  Scalar sum[N] = {};
  const Scalar* a = A.data();
  int k = 0;
  for (; k + 4 <= count; k += 4, a += 4 * N, weights += 4 * stride) {
    const Scalar w0 = weights[0], w1 = weights[stride], w2 = weights[2 * stride], w3 = weights[3 * stride];
    if (w0 == 0 && w1 == 0 && w2 == 0 && w3 == 0) continue;
    for (int i = 0; i < N; ++i) sum[i] += (a[i] * w0 + a[i + N] * w1) + (a[i + 2 * N] * w2 + a[i + 3 * N] * w3);
  }
  for (; k < count; ++k, a += N, weights += stride) {
    const Scalar w = weights[0];
    for (int i = 0; i < N; ++i) sum[i] += a[i] * w;
  }
  Eigen::Matrix<Scalar, N, 1> result;
  std::copy_n(sum, N, result.data());
  return result;
}

/// A B
template <class Scalar, int N, int Columns>
[[nodiscard]] Eigen::Matrix<Scalar, N, Columns> times(const Eigen::Matrix<Scalar, N, N>& A,
                                                      const Eigen::Matrix<Scalar, N, Columns>& B) {
  Eigen::Matrix<Scalar, N, Columns> result;
  for (int j = 0; j < Columns; ++j)
    std::copy_n(weighted_columns(A, N, B.data() + j * N, 1).data(), N, result.data() + j * N);
  return result;
}

/// A B^T
template <class Scalar, int N>
[[nodiscard]] Eigen::Matrix<Scalar, N, N> times_transposed(const Eigen::Matrix<Scalar, N, N>& A,
                                                           const Eigen::Matrix<Scalar, N, N>& B) {
  Eigen::Matrix<Scalar, N, N> result;
  for (int j = 0; j < N; ++j) std::copy_n(weighted_columns(A, N, B.data() + j, N).data(), N, result.data() + j * N);
  return result;
}

/// (A + A^T) / 2
template <class Scalar, int N>
[[nodiscard]] Eigen::Matrix<Scalar, N, N> symmetric(const Eigen::Matrix<Scalar, N, N>& A) {
  Eigen::Matrix<Scalar, N, N> result;
  for (int j = 0; j < N; ++j)
    for (int i = 0; i < N; ++i) result.data()[i + j * N] = Scalar(0.5) * (A.data()[i + j * N] + A.data()[j + i * N]);
  return result;
}

/// F P F^T, symmetric up to rounding, for a symmetric P.
template <class Scalar, int N>
[[nodiscard]] Eigen::Matrix<Scalar, N, N> congruent(const Eigen::Matrix<Scalar, N, N>& F,
                                                    const Eigen::Matrix<Scalar, N, N>& P) {
  const Eigen::Matrix<Scalar, N, N> P_F = times_transposed(P, F);
  return times_transposed(transposed(P_F), F);
}

/// L with L L^T = P, for a P that may be singular: Cholesky's factor, its rows in the order of P, its columns in that
/// of the pivots. The coordinate of which most variance is left, as a share of its own, comes next; once none has more
/// than rounding left, so that the outcome depends on no unit, all that remains is zero.
template <class Scalar, int N>
[[nodiscard]] Eigen::Matrix<Scalar, N, N> square_root(const Eigen::Matrix<Scalar, N, N>& P) {
  constexpr Scalar rounding = N * std::numeric_limits<Scalar>::epsilon();
  Eigen::Matrix<Scalar, N, N> L = zeros<Eigen::Matrix<Scalar, N, N>>();
  Scalar left[N];  // share of the variance
  for (int i = 0; i < N; ++i) left[i] = P(i, i) <= 0 ? Scalar(0) : Scalar(1);
  for (int k = 0; k < N; ++k) {
    int pivot = 0;
    for (int i = 1; i < N; ++i)
      if (left[pivot] < left[i] || left[i] != left[i]) pivot = i;  // NaN comes first: the caller shall see it
    if (left[pivot] <= rounding) break;
    const Scalar variance = left[pivot] * P(pivot, pivot);
    const Scalar scale = 1 / std::sqrt(variance);
    const Eigen::Matrix<Scalar, N, 1> known = weighted_columns(L, k, L.data() + pivot, N);
    for (int i = 0; i < N; ++i) {
      if (left[i] <= 0) continue;
      const Scalar root = i == pivot ? variance * scale : (P(i, pivot) - known[i]) * scale;
      L(i, k) = root;
      left[i] = i == pivot ? Scalar(0) : std::max(left[i] - root * root / P(i, i), Scalar(0));
    }
  }
  return L;
}

/// L with L L^T = A, lower triangular, for a positive definite A.
template <class Scalar, int N>
[[nodiscard]] Eigen::Matrix<Scalar, N, N> cholesky(const Eigen::Matrix<Scalar, N, N>& A) {
  Eigen::Matrix<Scalar, N, N> L = zeros<Eigen::Matrix<Scalar, N, N>>();
  for (int k = 0; k < N; ++k) {
    const Eigen::Matrix<Scalar, N, 1> known = weighted_columns(L, k, L.data() + k, N);
    const Scalar scale = 1 / std::sqrt(A(k, k) - known[k]);
    for (int i = k; i < N; ++i) L(i, k) = (A(i, k) - known[i]) * scale;
  }
  return L;
}

/// B L^-T for a lower triangular L.
template <class Scalar, int N>
[[nodiscard]] Eigen::Matrix<Scalar, N, N> solved_right(const Eigen::Matrix<Scalar, N, N>& B,
                                                       const Eigen::Matrix<Scalar, N, N>& L) {
  Eigen::Matrix<Scalar, N, N> result;
  for (int k = 0; k < N; ++k) {
    const Eigen::Matrix<Scalar, N, 1> known = weighted_columns(result, k, L.data() + k, N);
    const Scalar scale = 1 / L(k, k);
    for (int i = 0; i < N; ++i) result(i, k) = (B(i, k) - known[i]) * scale;
  }
  return result;
}

/// e^T A^-1 e for a positive definite A of n rows; NaN if it is not. Overwrites both: A by Cholesky's factor L below
/// the diagonal, e by L^-1 e.
[[nodiscard, gnu::noinline, gnu::cold]] inline double squared_mahalanobis(double* A, double* e, int n) {
  double sum = 0;
  for (int k = 0; k < n; ++k) {
    for (int i = k; i < n; ++i)
      for (int m = 0; m < k; ++m) A[i + k * n] -= A[i + m * n] * A[k + m * n];
    const double root = std::sqrt(A[k + k * n]);
    for (int i = k; i < n; ++i) A[i + k * n] /= root;
    for (int m = 0; m < k; ++m) e[k] -= A[k + m * n] * e[m];
    e[k] /= root;
    sum += e[k] * e[k];
  }
  return sum;
}

/// A bound on the largest eigenvalue of a symmetric matrix of n rows: the largest sum of a column's magnitudes. NaN if
/// one is.
[[nodiscard, gnu::noinline, gnu::cold]] inline double eigenvalue_bound(const double* A, int n) {
  double largest = 0;
  for (int column = 0; column < n; ++column) {
    double sum = 0;
    for (int row = 0; row < n; ++row) sum += std::abs(A[row + column * n]);
    if (std::isnan(sum)) return sum;
    largest = std::max(largest, sum);
  }
  return largest;
}

/// The same bound for a matrix's inverse, given Cholesky's factor L of n rows, which is overwritten by L^-1.
[[nodiscard, gnu::noinline, gnu::cold]] inline double inverse_eigenvalue_bound(double* L, int n) {
  for (int column = 0; column < n; ++column) {
    double* const x = L + column * n;
    const double diagonal = 1 / x[column];
    for (int row = column + 1; row < n; ++row) {
      double sum = -x[row] * diagonal;
      for (int k = column + 1; k < row; ++k) sum -= L[row + k * n] * x[k];
      x[row] = sum / L[row + row * n];
    }
    x[column] = diagonal;
  }
  double largest = 0;
  for (int column = 0; column < n; ++column) {
    double sum = 0;
    for (int row = 0; row < n; ++row) {
      double entry = 0;
      for (int k = std::max(row, column); k < n; ++k) entry += L[k + row * n] * L[k + column * n];
      sum += std::abs(entry);
    }
    if (std::isnan(sum)) return sum;
    largest = std::max(largest, sum);
  }
  return largest;
}

}  // namespace chainslam
