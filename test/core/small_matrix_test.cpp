#include "chainslam/core/small_matrix.hpp"

#include <doctest/doctest.h>

#include "support/property.hpp"

namespace chainslam::test {
namespace {

template <int Rows, int Inner, int Columns>
void check_products(Rng& rng) {
  const auto random = [&]<class Matrix>(Matrix matrix) {
    for (Eigen::Index i = 0; i < matrix.size(); ++i) matrix.data()[i] = rng.normal();
    return matrix;
  };
  const auto A = random(Eigen::Matrix<double, Rows, Inner>());
  const auto B = random(Eigen::Matrix<double, Inner, Columns>());
  const Eigen::Matrix<double, Rows, Columns> expected = A * B;
  const Eigen::Matrix<double, Inner, Rows> A_transposed = A.transpose();
  const Eigen::Matrix<double, Columns, Inner> B_transposed = B.transpose();
  CHECK((product(A, B) - expected).norm() < 1e-14 * A.norm() * B.norm());
  CHECK(product_transposed(A, B_transposed) == product(A, B));
  CHECK(transposed_product(A_transposed, B) == product(A, B));
  CHECK(transposed(A) == A_transposed);
}

template <int Rows, int Columns>
void check_sums(Rng& rng) {
  using Matrix = Eigen::Matrix<double, Rows, Columns>;
  Matrix A, B;
  for (Eigen::Index i = 0; i < A.size(); ++i) A.data()[i] = rng.normal(), B.data()[i] = rng.normal();
  const double factor = rng.normal();
  // Entry by entry, so to the last bit.
  CHECK(sum_of(A, B) == Matrix(A + B));
  CHECK(difference_of(A, B) == Matrix(A - B));
  CHECK(negative(A) == Matrix(-A));
  CHECK(scaled(factor, A) == Matrix(factor * A));
  CHECK(converted<float>(A) == Eigen::Matrix<float, Rows, Columns>(A.template cast<float>()));
}

}  // namespace

TEST_SUITE("core/small_matrix") {
  TEST_CASE("products and transposes are Eigen's") {
    for_all(50, [](Rng& rng, int) {
      check_products<3, 3, 3>(rng);
      check_products<3, 3, 1>(rng);
      check_products<1, 3, 3>(rng);
      check_products<2, 3, 6>(rng);
      check_products<6, 6, 6>(rng);
      check_products<6, 1, 6>(rng);
      check_products<26, 9, 4>(rng);
    });
  }

  TEST_CASE("sums, differences and multiples are Eigen's") {
    for_all(50, [](Rng& rng, int) {
      check_sums<3, 1>(rng);
      check_sums<3, 3>(rng);
      check_sums<2, 6>(rng);
      check_sums<26, 26>(rng);
    });
  }

  TEST_CASE("zeros and the identity") {
    CHECK(zeros<Eigen::Matrix<double, 3, 5>>() == Eigen::Matrix<double, 3, 5>::Zero());
    CHECK(identity<Eigen::Matrix4f>() == Eigen::Matrix4f::Identity());
  }

  TEST_CASE("a symmetric matrix of its upper triangle, and squared distances") {
    const Eigen::Matrix3d expected{{1, 2, 3}, {2, 4, 5}, {3, 5, 6}};
    CHECK(symmetric_matrix(1.0, 2.0, 3.0, 4.0, 5.0, 6.0) == expected);
    const double a[] = {1, 2, 3}, b[] = {2, 4, 6};
    CHECK(squared_distance<3>(a, b) == 14);
    CHECK(squared_distance<2>(a, b) == 5);
  }

  TEST_CASE("a block that was set is what is read, and nothing else has changed") {
    Eigen::Matrix<double, 5, 7> A = Eigen::Matrix<double, 5, 7>::Random(), before = A;
    const Eigen::Matrix<double, 2, 3> block{{1, 2, 3}, {4, 5, 6}};
    set_block(A, 3, 4, block);
    CHECK(block_of<2, 3>(A, 3, 4) == block);
    before.block<2, 3>(3, 4) = block;
    CHECK(A == before);
  }
}

}  // namespace chainslam::test
