#include "chainslam/slam/loop_closer.hpp"

#include <doctest/doctest.h>

#include <Eigen/Cholesky>
#include <cmath>

#include "support/property.hpp"

namespace chainslam {
namespace {

AlignResult aligned(const Matrix6d& hessian, double mean_squared_error, double mean_squared_residual) {
  AlignResult result;
  result.hessian = hessian;
  result.mean_squared_error = mean_squared_error;
  result.mean_squared_residual = mean_squared_residual;
  result.status = AlignStatus::converged;
  return result;
}

TEST_SUITE("slam/closure_covariance") {
  TEST_CASE("the paper's is the same number for all six directions, and never nothing") {
    const IsotropicCovariance covariance{.lambda = 1e-4, .least = 1e-9};
    CHECK(covariance(aligned({}, 0.04, 7)).isApprox(4e-6 * Matrix6d::Identity(), 1e-14));
    CHECK(covariance(aligned({}, 0, 7)) == 1e-9 * Matrix6d::Identity());
  }

  TEST_CASE("a diagonal Hessian gives (H / (c s^2) + P)^-1 + F, one direction at a time") {
    const HessianCovariance covariance{.correlated_residuals = 50,
                                       .prior_translation = 4,
                                       .prior_rotation = 0.5,
                                       .floor_translation = 0.1,
                                       .floor_rotation = 0.01};
    Vector6d information;
    information << 100, 200, 0, 3000, 0, 5000;
    const Matrix6d result = covariance(aligned(information.asDiagonal(), 1, 0.02));
    Vector6d expected;
    for (int i = 0; i < 6; ++i) {
      const double prior = i < 3 ? 4.0 : 0.5, floor = i < 3 ? 0.1 : 0.01;
      expected[i] = 1 / (information[i] / (50 * 0.02) + 1 / (prior * prior)) + floor * floor;
    }
    CHECK(result.isApprox(Matrix6d(expected.asDiagonal()), 1e-12));
  }

  TEST_CASE("a direction that the points do not determine stays as open as the search was wide") {
    const HessianCovariance covariance;
    Vector6d along = Vector6d::Zero();
    along.head<3>() = Eigen::Vector3d(3, 4, 0).normalized();
    const Matrix6d hessian = 1e5 * (Matrix6d::Identity() - along * along.transpose());
    const Matrix6d result = covariance(aligned(hessian, 0.01, 0.001));
    CHECK(std::sqrt(along.dot(result * along)) == doctest::Approx(std::hypot(5.0, 0.05)).epsilon(1e-6));
    const Vector6d across = Vector6d::Unit(2);
    CHECK(std::sqrt(across.dot(result * across)) < 0.06);
  }

  TEST_CASE("residuals below the sensor's noise claim no more than that noise") {
    const HessianCovariance covariance;
    const Matrix6d hessian = 1e4 * Matrix6d::Identity();
    CHECK(covariance(aligned(hessian, 0, 0)) == covariance(aligned(hessian, 0, 1e-4)));
  }

  TEST_CASE("whatever the Hessian, the covariance is symmetric and positive definite") {
    test::for_all(100, [](Rng& rng, int size) {
      const int rank = size % 7;
      Eigen::Matrix<double, 6, Eigen::Dynamic> root(6, rank);
      for (Eigen::Index i = 0; i < root.size(); ++i) root(i) = rng.normal() * std::pow(10.0, rng.uniform(-3, 4));
      const Matrix6d hessian = root * root.transpose();
      const Matrix6d result = HessianCovariance{}(aligned(hessian, rng.uniform(), std::pow(10.0, rng.uniform(-8, 0))));
      CHECK(result == result.transpose());
      CHECK(result.llt().info() == Eigen::Success);
      CHECK(result.diagonal().minCoeff() > 0);
      // No direction is known worse than before the search: prior and floor.
      CHECK(result.topLeftCorner<3, 3>().diagonal().maxCoeff() <= 25 + 0.05 * 0.05 + 1e-6);
    });
  }

  TEST_CASE(
      "a turn that the points do not determine stays as open as the search was wide, others are known to the floor") {
    const HessianCovariance covariance;
    Vector6d hessian = Vector6d::Constant(1e8);
    hessian[5] = 0;
    const Matrix6d result = covariance(aligned(hessian.asDiagonal(), 0.01, 0.001));
    CHECK(std::sqrt(result(5, 5)) == doctest::Approx(std::hypot(0.2, 0.002)).epsilon(1e-3));
    CHECK(std::sqrt(result(4, 4)) == doctest::Approx(0.002).epsilon(1e-2));
    CHECK(std::sqrt(result(0, 0)) == doctest::Approx(0.05).epsilon(1e-3));
  }

  TEST_CASE("a hundred residuals count as one: neighbours err together") {
    const Vector6d hessian = Vector6d::Constant(1000);
    const Matrix6d result = HessianCovariance{}(aligned(hessian.asDiagonal(), 0.01, 0.01));
    CHECK(std::sqrt(result(0, 0) - 0.05 * 0.05) == doctest::Approx(0.1 / std::sqrt(1000.0 / 100)).epsilon(1e-3));
  }
}

}  // namespace
}  // namespace chainslam
