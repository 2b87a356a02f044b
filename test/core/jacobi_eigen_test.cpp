#include "chainslam/core/symmetric_eigen.hpp"

#include <doctest/doctest.h>

#include "support/property.hpp"

namespace chainslam::test {
namespace {

template <int N>
Eigen::Matrix<double, N, N> random_symmetric(Rng& rng) {
  Eigen::Matrix<double, N, N> matrix;
  for (int i = 0; i < N; ++i)
    for (int j = 0; j <= i; ++j) matrix(i, j) = matrix(j, i) = rng.normal();
  return matrix;
}

}  // namespace

TEST_SUITE("core/jacobi_eigen") {
  TEST_CASE("vectors are orthonormal, values ascend, and together they make the matrix") {
    for_all(200, [](Rng& rng, int) {
      const Eigen::Matrix<double, 6, 6> matrix = random_symmetric<6>(rng);
      const auto eigen = jacobi_eigen(matrix);
      CHECK((eigen.vectors.transpose() * eigen.vectors - Eigen::Matrix<double, 6, 6>::Identity()).norm() < 1e-13);
      CHECK((eigen.vectors * eigen.values.asDiagonal() * eigen.vectors.transpose() - matrix).norm() < 1e-13);
      for (int i = 1; i < 6; ++i) CHECK(eigen.values[i - 1] <= eigen.values[i]);
    });
  }

  TEST_CASE("small eigenvalues of a badly scaled matrix keep their digits") {
    // diag(1, 1e-8) [2 1; 1 2] diag(1, 1e-8): product of the values = 3e-16, their sum 2 + 2e-16.
    Eigen::Matrix2d matrix;
    matrix << 2, 1e-8, 1e-8, 2e-16;
    const auto eigen = jacobi_eigen(matrix);
    CHECK(eigen.values[0] == doctest::Approx(1.5e-16).epsilon(1e-14));
    CHECK(eigen.values[1] == doctest::Approx(2.0).epsilon(1e-14));
  }

  TEST_CASE("singular, diagonal and zero matrices") {
    const Eigen::Matrix4d rank_one = Eigen::Vector4d(1, 2, 3, 4) * Eigen::RowVector4d(1, 2, 3, 4);
    const auto eigen = jacobi_eigen(rank_one);
    CHECK(eigen.values[3] == doctest::Approx(30.0).epsilon(1e-14));
    CHECK(eigen.values.head<3>().norm() < 1e-14);
    CHECK(jacobi_eigen(Eigen::Matrix3d(Eigen::Matrix3d::Zero())).values == Eigen::Vector3d::Zero());
    const Eigen::Matrix3d diagonal = Eigen::Vector3d(3, -1, 2).asDiagonal();
    CHECK(jacobi_eigen(diagonal).values == Eigen::Vector3d(-1, 2, 3));
  }
}

}  // namespace chainslam::test
