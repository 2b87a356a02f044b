#include "chainslam/core/small_matrix.hpp"

#include <doctest/doctest.h>

#include "support/property.hpp"

namespace chainslam::test {
namespace {

template <int Rows, int Columns>
Eigen::Matrix<double, Rows, Columns> random_matrix(Rng& rng) {
  Eigen::Matrix<double, Rows, Columns> matrix;
  for (Eigen::Index i = 0; i < matrix.size(); ++i) matrix.data()[i] = rng.normal();
  return matrix;
}

/// The same matrix with its size known at run time: Eigen's expressions of it are compiled once, not for each size. Not
/// inlined: of two doubles that become floats and doubles again at once, g++ 12 leaves out the rounding.
template <class Scalar, int Rows, int Columns>
[[gnu::noinline]] Eigen::MatrixXd any_size(const Eigen::Matrix<Scalar, Rows, Columns>& matrix) {
  Eigen::MatrixXd result(Rows, Columns);
  for (Eigen::Index j = 0; j < Columns; ++j)
    for (Eigen::Index i = 0; i < Rows; ++i) result(i, j) = static_cast<double>(matrix(i, j));
  return result;
}

void compare_products(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B, const Eigen::MatrixXd& product_A_B,
                      const Eigen::MatrixXd& transposed_A) {
  CHECK(Eigen::MatrixXd(product_A_B - A * B).norm() < 1e-14 * A.norm() * B.norm());
  CHECK(transposed_A == Eigen::MatrixXd(A.transpose()));
}

template <int Rows, int Inner, int Columns>
void check_products(Rng& rng) {
  const auto A = random_matrix<Rows, Inner>(rng);
  const auto B = random_matrix<Inner, Columns>(rng);
  const Eigen::Matrix<double, Rows, Columns> AB = product(A, B);
  const Eigen::Matrix<double, Inner, Rows> A_transposed = transposed(A);
  compare_products(any_size(A), any_size(B), any_size(AB), any_size(A_transposed));
  CHECK(any_size(product_transposed(A, transposed(B))) == any_size(AB));
  CHECK(any_size(transposed_product(A_transposed, B)) == any_size(AB));
}

/// Entry by entry, so to the last bit.
void compare_sums(double factor, const Eigen::MatrixXd& A, const Eigen::MatrixXd& B, const Eigen::MatrixXd& sum,
                  const Eigen::MatrixXd& difference, const Eigen::MatrixXd& negative_A, const Eigen::MatrixXd& scaled_A,
                  const Eigen::MatrixXd& A_as_float) {
  CHECK(sum == Eigen::MatrixXd(A + B));
  CHECK(difference == Eigen::MatrixXd(A - B));
  CHECK(negative_A == Eigen::MatrixXd(-A));
  CHECK(scaled_A == Eigen::MatrixXd(factor * A));
  CHECK(A_as_float == Eigen::MatrixXd(A.cast<float>().cast<double>()));
}

template <int Rows, int Columns>
void check_sums(Rng& rng) {
  const auto A = random_matrix<Rows, Columns>(rng), B = random_matrix<Rows, Columns>(rng);
  const double factor = rng.normal();
  compare_sums(factor, any_size(A), any_size(B), any_size(sum_of(A, B)), any_size(difference_of(A, B)),
               any_size(negative(A)), any_size(scaled(factor, A)), any_size(converted<float>(A)));
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
