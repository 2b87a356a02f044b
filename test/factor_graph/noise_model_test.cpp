#include "chainslam/factor_graph/noise_model.hpp"

#include <doctest/doctest.h>

#include <Eigen/Cholesky>
#include <limits>
#include <stdexcept>

#include "chainslam/core/random.hpp"
#include "chainslam/core/types.hpp"
#include "support/property.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

using Noise = NoiseModel<6>;

Matrix6d random_matrix(Rng& rng) {
  return Matrix6d::NullaryExpr([&](Eigen::Index, Eigen::Index) { return rng.normal(); });
}

}  // namespace

TEST_SUITE("factor_graph/noise_model") {
  TEST_CASE("covariance, information and their root say the same") {
    for_all(50, [](Rng& rng, int) {
      const Matrix6d root = 2.0 * Matrix6d::Identity() + 0.3 * random_matrix(rng);
      const Matrix6d information = root.transpose() * root;
      const Matrix6d covariance = information.llt().solve(Matrix6d::Identity());
      CHECK(Noise::from_information(information).information().isApprox(information, 1e-12));
      CHECK(
          Noise::from_covariance((covariance + covariance.transpose()) / 2).information().isApprox(information, 1e-9));
      CHECK(Noise::from_sqrt_information(root).information().isApprox(information, 1e-14));
    });
  }

  TEST_CASE("sigmas are standard deviations; infinite ones carry no information") {
    Vector6d sigmas = Vector6d::Constant(0.5);
    sigmas[2] = std::numeric_limits<double>::infinity();
    Vector6d expected = Vector6d::Constant(4.0);
    expected[2] = 0.0;
    CHECK(Noise::from_sigmas(sigmas).information() == Matrix6d(expected.asDiagonal()));
    CHECK(Noise::from_sigma(0.5).information() == 4.0 * Matrix6d::Identity());
  }

  TEST_CASE("information without some directions is kept") {
    for_all(50, [](Rng& rng, int size) {
      const int rank = size % 6;
      const Eigen::MatrixXd half = random_matrix(rng).topRows(rank);
      const Matrix6d information = half.transpose() * half;
      CHECK((Noise::from_information(information).information() - information).norm() <=
            1e-13 * (1 + information.norm()));
    });
    CHECK(Noise::from_information(Matrix6d::Zero()).information() == Matrix6d::Zero());
  }

  TEST_CASE("variances 24 orders apart make a covariance") {
    Vector6d variances;
    variances << 1e-12, 1e-12, 1e-12, 1e12, 1e12, 1e12;
    const Noise noise = Noise::from_covariance(variances.asDiagonal());
    CHECK(noise.information().diagonal().cwiseProduct(variances).isApprox(Vector6d::Ones(), 1e-12));
  }

  TEST_CASE("what is not a number, not symmetric or negative is refused") {
    Matrix6d nan = Matrix6d::Identity();
    nan(3, 3) = std::numeric_limits<double>::quiet_NaN();
    Matrix6d skew = Matrix6d::Identity();
    skew(0, 1) = 0.1;
    Matrix6d negative = Matrix6d::Identity();
    negative(4, 4) = -1.0;
    Matrix6d hidden = Matrix6d::Identity();  // all entries positive, one direction negative
    hidden(0, 1) = hidden(1, 0) = 2.0;
    for (const Matrix6d& bad : {nan, skew, negative, hidden}) {
      CHECK_THROWS_AS(static_cast<void>(Noise::from_covariance(bad)), std::invalid_argument);
      CHECK_THROWS_AS(static_cast<void>(Noise::from_information(bad)), std::invalid_argument);
    }
    CHECK_THROWS_AS(static_cast<void>(Noise::from_sqrt_information(nan)), std::invalid_argument);
    CHECK_THROWS_AS(static_cast<void>(Noise::from_covariance(Matrix6d::Zero())), std::invalid_argument);
    for (const double bad : {0.0, -1.0, std::numeric_limits<double>::quiet_NaN()})
      CHECK_THROWS_AS(static_cast<void>(Noise::from_sigma(bad)), std::invalid_argument);
  }
}
