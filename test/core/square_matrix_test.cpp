#include "chainslam/core/small_matrix.hpp"

#include <doctest/doctest.h>

#include <Eigen/Eigenvalues>
#include <cmath>
#include <cstdint>
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

/// The same matrix with its size known at run time: Eigen's expressions of it are compiled once, not for each N.
template <int N, int Columns>
Eigen::MatrixXd any_size(const Eigen::Matrix<double, N, Columns>& matrix) {
  return Eigen::Map<const Eigen::MatrixXd>(matrix.data(), N, Columns);
}

/// What was computed of A, B, a sparse S and P = A A^T + I, as square matrices but for the product with a vector x, B's
/// first column.
struct Results {
  Eigen::MatrixXd A_x, A_B, A_Bt, A_S, S_St, A_P_At, symmetric_A, L, B_over_Lt, root;
};

void compare_with_eigen(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B, const Eigen::MatrixXd& S,
                        const Eigen::MatrixXd& P, const Results& results) {
  const Eigen::MatrixXd At = A.transpose(), Bt = B.transpose(), St = S.transpose(), Lt = results.L.transpose();
  const double n = static_cast<double>(A.rows());
  const auto near = [](const Eigen::MatrixXd& a, const Eigen::MatrixXd& b, double bound) {
    return Eigen::MatrixXd(a - b).norm() < bound;
  };
  CHECK(near(results.A_x, A * Eigen::MatrixXd(B.col(0)), n * rounding));
  CHECK(near(results.A_B, A * B, n * n * rounding));
  CHECK(near(results.A_Bt, A * Bt, n * n * rounding));
  CHECK(near(results.A_S, A * S, n * n * rounding));
  CHECK(near(results.S_St, S * St, n * n * rounding));
  CHECK(near(results.A_P_At, Eigen::MatrixXd(A * P) * At, n * n * n * rounding));
  CHECK(results.symmetric_A == Eigen::MatrixXd(0.5 * (A + At)));
  CHECK(near(results.L * Lt, P, n * n * rounding));
  for (Eigen::Index j = 0; j < Lt.cols(); ++j)
    for (Eigen::Index i = j + 1; i < Lt.rows(); ++i) CHECK(Lt(i, j) == 0);
  CHECK(near(results.B_over_Lt * Lt, B, n * n * rounding));
  CHECK(near(results.root * results.root.transpose(), P, n * n * rounding));
}

template <int N>
void check_against_eigen() {
  using Matrix = Eigen::Matrix<double, N, N>;
  Rng rng(N);
  const Matrix A = filled<N>(rng), B = filled<N>(rng);
  Matrix S = Matrix::Identity();
  S(0, N - 1) = 3;
  Eigen::Matrix<double, N, 1> x;
  for (int i = 0; i < N; ++i) x[i] = B(i, 0);
  Matrix P = times_transposed(A, A);
  for (int i = 0; i < N; ++i) P(i, i) += 1;
  const Matrix L = cholesky(P);
  compare_with_eigen(any_size(A), any_size(B), any_size(S), any_size(P),
                     {.A_x = any_size(times(A, x)),
                      .A_B = any_size(times(A, B)),
                      .A_Bt = any_size(times_transposed(A, B)),
                      .A_S = any_size(times(A, S)),
                      .S_St = any_size(times_transposed(S, S)),
                      .A_P_At = any_size(congruent(A, P)),
                      .symmetric_A = any_size(symmetric(A)),
                      .L = any_size(L),
                      .B_over_Lt = any_size(solved_right(B, L)),
                      .root = any_size(square_root(P))});
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

  TEST_CASE("bounds on eigenvalues hold for a matrix and its inverse, are exact for a diagonal one, and hand on NaN") {
    constexpr int n = 7;
    using Matrix = Eigen::Matrix<double, n, n>;
    for (int seed = 0; seed < 20; ++seed) {
      Rng rng(static_cast<std::uint64_t>(seed));
      Matrix P = filled<n>(rng) * 0.3;
      P = Matrix(P * P.transpose()) + Matrix::Identity();
      const Eigen::VectorXd eigenvalues = Eigen::MatrixXd(P).selfadjointView<Eigen::Lower>().eigenvalues();
      const double largest = eigenvalue_bound(P.data(), n);
      CHECK(largest >= eigenvalues.maxCoeff());
      CHECK(largest <= n * eigenvalues.maxCoeff());
      Matrix L = cholesky(P);
      const double of_inverse = inverse_eigenvalue_bound(L.data(), n);
      CHECK(of_inverse >= 1 / eigenvalues.minCoeff());
      CHECK(of_inverse <= n / eigenvalues.minCoeff());
    }
    Matrix D = Matrix::Identity() * 4.0;
    CHECK(eigenvalue_bound(D.data(), n) == 4.0);
    Matrix root = Matrix::Identity() * 2.0;
    CHECK(inverse_eigenvalue_bound(root.data(), n) == 0.25);
    D(3, 3) = root(3, 3) = std::numeric_limits<double>::quiet_NaN();
    CHECK(std::isnan(eigenvalue_bound(D.data(), n)));
    CHECK(std::isnan(inverse_eigenvalue_bound(root.data(), n)));
  }
}

}  // namespace
}  // namespace chainslam
