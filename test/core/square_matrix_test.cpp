#include "chainslam/core/square_matrix.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>

#include "chainslam/core/random.hpp"

namespace chainslam {
namespace {

template <int N>
Eigen::Matrix<double, N, N> filled(Rng& rng) {
  Eigen::Matrix<double, N, N> matrix;
  for (int i = 0; i < N * N; ++i) matrix.data()[i] = rng.normal();
  return matrix;
}

/// Sums of N products of numbers near 1, each rounded.
constexpr double rounding = 1e-13;

template <int N>
void check_against_eigen() {
  using Matrix = Eigen::Matrix<double, N, N>;
  Rng rng(N);
  const Matrix A = filled<N>(rng), B = filled<N>(rng);
  Matrix sparse = Matrix::Identity();
  sparse(0, N - 1) = 3;
  const Eigen::Matrix<double, N, 1> x = B.col(0);
  const Matrix P = A * A.transpose() + Matrix::Identity();
  CHECK((times(A, x) - A * x).norm() < N * rounding);
  CHECK((times(A, B) - A * B).norm() < N * N * rounding);
  CHECK((times_transposed(A, B) - A * B.transpose()).norm() < N * N * rounding);
  CHECK((times(A, sparse) - A * sparse).norm() < N * N * rounding);
  CHECK((times_transposed(sparse, sparse) - sparse * sparse.transpose()).norm() < N * N * rounding);
  CHECK((congruent(A, P) - A * P * A.transpose()).norm() < N * N * N * rounding);
  CHECK(symmetric(A) == Matrix(0.5 * (A + A.transpose())));
  const Matrix L = cholesky(P);
  CHECK((L * L.transpose() - P).norm() < N * N * rounding);
  CHECK(L == Matrix(L.template triangularView<Eigen::Lower>()));
  CHECK((solved_right(B, L) * L.transpose() - B).norm() < N * N * rounding);
  const Matrix root = square_root(P);
  CHECK((root * root.transpose() - P).norm() < N * N * rounding);
}

TEST_SUITE("core/square_matrix") {
  TEST_CASE("products and factors are Eigen's, up to rounding, whatever the size leaves over groups of four") {
    check_against_eigen<1>();
    check_against_eigen<3>();
    check_against_eigen<6>();
    check_against_eigen<10>();
    check_against_eigen<12>();
    check_against_eigen<14>();
    check_against_eigen<16>();
    check_against_eigen<26>();
  }

  TEST_CASE("the square root of a singular matrix, in units far apart, has the rank of the matrix and gives it back") {
    using Matrix = Eigen::Matrix<double, 9, 9>;
    Rng rng(1);
    for (int rank = 0; rank <= 9; ++rank) {
      Matrix factor = filled<9>(rng);
      for (int j = rank; j < 9; ++j) factor.col(j).setZero();
      for (int i = 0; i < 9; ++i) factor.row(i) *= std::pow(10.0, i - 4);
      const Matrix P = symmetric(Matrix(factor * factor.transpose()));
      const Matrix root = square_root(P), back = root * root.transpose();
      for (int j = 0; j < 9; ++j) {
        for (int i = 0; i < 9; ++i) CHECK(std::abs(back(i, j) - P(i, j)) <= rounding * std::sqrt(P(i, i) * P(j, j)));
        CHECK((root.col(j).norm() > 0) == (j < rank));
      }
    }
  }

  TEST_CASE("a coordinate without variance has no part in the square root, and NaN is handed on") {
    Eigen::Matrix4d P = Eigen::Matrix4d::Identity();
    P(2, 2) = 0;
    CHECK(square_root(P).row(2).norm() == 0);
    P(1, 1) = std::numeric_limits<double>::quiet_NaN();
    CHECK(std::isnan(square_root(P).sum()));
  }
}

}  // namespace
}  // namespace chainslam
