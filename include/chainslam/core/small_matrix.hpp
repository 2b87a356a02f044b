#pragma once

#include <Eigen/Core>
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

}  // namespace chainslam
