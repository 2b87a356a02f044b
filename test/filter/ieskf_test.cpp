#include "chainslam/filter/ieskf.hpp"

#include <doctest/doctest.h>

#include <Eigen/LU>
#include <cmath>
#include <limits>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/lie/rn.hpp"

using namespace chainslam;

namespace {

using R4d = Rn<double, 4>;
using Vector4 = Eigen::Vector4d;
using Matrix4 = Eigen::Matrix4d;

/// x' = A x + noise.
struct LinearProcess {
  struct Input {};
  Matrix4 A = Matrix4::Identity();
  Matrix4 Q = Matrix4::Zero();
  [[nodiscard]] Transition<R4d> predict(const R4d& x, const Input&, double) const { return {R4d(A * x.value()), A, Q}; }
};

/// z = H x + noise, two rows.
struct LinearMeasurement {
  Eigen::Matrix<double, 2, 4> H;
  Eigen::Vector2d z;
  double variance;
  Linearization<R4d> linearize(const R4d& x, bool) const {
    const Eigen::Vector2d r = H * x.value() - z;
    return {.information = H.transpose() * H / variance,
            .gradient = -H.transpose() * r / variance,
            .squared_error = r.squaredNorm() / variance,
            .residuals = 2};
  }
};
static_assert(MeasurementModel<LinearMeasurement, R4d> && !MeasurementModel<LinearProcess, R4d>);
static_assert(ProcessModel<LinearProcess, R4d> && !ProcessModel<LinearMeasurement, R4d>);

using LinearFilter = Ieskf<R4d, LinearProcess>;

template <class Matrix>
Matrix filled(Rng& rng) {
  Matrix m;
  for (auto& value : m.reshaped()) value = rng.normal();
  return m;
}
Matrix4 covariance_of(Rng& rng) {
  const Matrix4 root = filled<Matrix4>(rng);
  return root * root.transpose();
}
LinearMeasurement measurement_of(Rng& rng) {
  return {filled<Eigen::Matrix<double, 2, 4>>(rng), filled<Eigen::Vector2d>(rng), 0.25};
}

}  // namespace

TEST_SUITE("filter/ieskf") {
  TEST_CASE("a linear system: Kalman's equations, from his paper of 1960") {
    Rng rng(1);
    Vector4 x = filled<Vector4>(rng);
    Matrix4 P = covariance_of(rng);
    LinearFilter filter(R4d(x), P, {filled<Matrix4>(rng), covariance_of(rng)});
    for (int step = 0; step < 5; ++step) {
      const Matrix4 A = filter.process.A;
      x = A * x;
      P = A * P * A.transpose() + filter.process.Q;
      filter.predict({}, 0.1);
      LinearMeasurement z = measurement_of(rng);
      const Eigen::Matrix2d innovation = z.H * P * z.H.transpose() + z.variance * Eigen::Matrix2d::Identity();
      const Eigen::Matrix<double, 4, 2> K = P * z.H.transpose() * innovation.inverse();
      const Eigen::Vector2d r = z.z - z.H * x;
      x += K * r;
      P = (Matrix4::Identity() - K * z.H) * P;
      const FilterReport<R4d> report = filter.update(z);
      CHECK(report.status == FilterStatus::converged);
      CHECK(report.nis == doctest::Approx(r.dot(innovation.inverse() * r)));
      CHECK((filter.state().value() - x).norm() < 1e-10 * (1 + x.norm()));
      CHECK((filter.covariance() - P).norm() < 1e-10 * (1 + P.norm()));
    }
  }

  TEST_CASE("a coordinate without variance stays where it is, exactly") {
    Rng rng(2);
    Matrix4 P = covariance_of(rng);
    P.row(2).setZero();
    P.col(2).setZero();
    LinearFilter filter(R4d(Vector4(1, 2, 3, 4)), P);
    LinearMeasurement z = measurement_of(rng);
    CHECK(filter.update(z).accepted());
    CHECK(filter.state().value()[2] == 3);
    CHECK(filter.covariance().row(2).isZero(0));
    CHECK(filter.state().value()[0] != 1);
  }

  TEST_CASE("covariances from 1e-12 to 1e8 stay symmetric and semi-definite through a thousand updates") {
    Rng rng(3);
    LinearFilter filter(R4d(), Vector4(1e-12, 1, 1e4, 1e8).asDiagonal());
    for (int i = 0; i < 1000; ++i) {
      LinearMeasurement z = measurement_of(rng);
      z.variance = i % 2 == 0 ? 1e-8 : 1.0;
      CHECK(filter.update(z).accepted());
      REQUIRE(filter.covariance() == filter.covariance().transpose());
      REQUIRE(filter.covariance().diagonal().minCoeff() >= 0);
    }
  }

  TEST_CASE("without residuals, and with broken ones, prediction and covariance are kept") {
    Rng rng(4);
    const Matrix4 P = covariance_of(rng);
    LinearFilter filter(R4d(Vector4(1, 2, 3, 4)), P);
    struct {
      Linearization<R4d> answer;
      Linearization<R4d> linearize(const R4d&, bool) const { return answer; }
    } measurement;
    CHECK(filter.update(measurement).status == FilterStatus::no_information);
    measurement.answer.residuals = 1;
    measurement.answer.gradient[1] = std::numeric_limits<double>::quiet_NaN();
    CHECK(filter.update(measurement).status == FilterStatus::not_finite);
    CHECK(filter.state().value() == Vector4(1, 2, 3, 4));
    CHECK(filter.covariance() == P);
  }

  TEST_CASE("a measurement that is not settled is asked again, and told when to renew") {
    struct {
      std::vector<bool> renewals;
      bool settles;
      Linearization<R4d> linearize(const R4d& x, bool renew) {
        renewals.push_back(renew);
        return {.information = Matrix4::Identity(),
                .gradient = -x.value(),
                .residuals = 4,
                .settled = settles && renewals.size() > 2};
      }
    } measurement{{}, true};
    LinearFilter filter(R4d(), Matrix4::Identity());
    CHECK(filter.update(measurement).status == FilterStatus::converged);
    CHECK(measurement.renewals == std::vector<bool>{false, true, true});
    measurement = {{}, false};
    CHECK(filter.update(measurement, {.max_iterations = 2}).status == FilterStatus::iteration_limit);
  }
}
