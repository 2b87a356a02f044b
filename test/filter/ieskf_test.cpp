#include "chainslam/odometry/ieskf.hpp"

#include <doctest/doctest.h>

#include <Eigen/LU>
#include <cmath>
#include <limits>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/lie/jacobians.hpp"
#include "chainslam/lie/product.hpp"
#include "chainslam/lie/rn.hpp"
#include "chainslam/lie/so3.hpp"
#include "support/property.hpp"

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

using Pose = Product<Rn<double, 3>, SO3d>;

struct StandingProcess {
  struct Input {};
  [[nodiscard]] Transition<Pose> predict(const Pose& x, const Input&, double) const {
    return {x, Transition<Pose>::Matrix::Identity(), Transition<Pose>::Matrix::Zero()};
  }
};
using PoseFilter = Ieskf<Pose, StandingProcess>;

/// Landmarks seen from a pose, in its own axes: z = R^-1 (l - p) + noise.
struct Landmarks {
  std::vector<Eigen::Vector3d> places{}, seen{};
  double variance;

  [[nodiscard]] Eigen::Vector3d residual(const Pose& x, std::size_t i) const {
    return x.get<1>().inverse() * Eigen::Vector3d(places[i] - x.get<0>().value()) - seen[i];
  }
  [[nodiscard]] double squared_error(const Pose& x) const {
    double sum = 0;
    for (std::size_t i = 0; i < places.size(); ++i) sum += residual(x, i).squaredNorm() / variance;
    return sum;
  }
  Linearization<Pose> linearize(const Pose& x, bool) const {
    Linearization<Pose> sum;
    for (std::size_t i = 0; i < places.size(); ++i) {
      const Eigen::Vector3d r = residual(x, i);
      Eigen::Matrix<double, 3, 6> H;
      H << -x.get<1>().inverse().matrix(), SO3d::hat(r + seen[i]);
      sum.information += H.transpose() * H / variance;
      sum.gradient -= H.transpose() * r / variance;
    }
    sum.squared_error = squared_error(x);
    sum.residuals = 3 * to_index(places.size());
    return sum;
  }
};

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
Eigen::Vector3d any_vector(Rng& rng, double deviation) {
  return {rng.normal(0, deviation), rng.normal(0, deviation), rng.normal(0, deviation)};
}
Pose moved(const Pose& x, Rng& rng, double distance, double angle) {
  Pose::Tangent step;
  step << any_vector(rng, distance), any_vector(rng, angle);
  return x.retract(step);
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

  TEST_CASE("from any guess, a linear measurement leads to the same estimate, covariance and figures") {
    test::for_all(50, [](Rng& rng, int) {
      const Vector4 x = filled<Vector4>(rng);
      const Matrix4 P = covariance_of(rng);
      LinearMeasurement z = measurement_of(rng);
      LinearFilter from_prediction(R4d(x), P), from_guess(R4d(x), P);
      const IterationRule rule{.max_iterations = 10, .step_tolerance = 1e-9};
      const FilterReport<R4d> expected = from_prediction.update(z, rule);
      const FilterReport<R4d> found = from_guess.update(z, rule, R4d(Vector4(x + 10 * filled<Vector4>(rng))));
      const double size = 1 + from_prediction.state().value().norm();
      CHECK(found.status == FilterStatus::converged);
      CHECK((from_guess.state().value() - from_prediction.state().value()).norm() < 1e-8 * size);
      CHECK((from_guess.covariance() - from_prediction.covariance()).norm() < 1e-8 * (1 + P.norm()));
      CHECK(found.nis == doctest::Approx(expected.nis).epsilon(1e-6));
      CHECK((found.correction - expected.correction).norm() < 1e-8 * size);
      const double by_prior = expected.correction.dot(P.inverse() * expected.correction);
      CHECK(expected.prior_error == doctest::Approx(by_prior).epsilon(1e-5));
      CHECK(found.prior_error == doctest::Approx(by_prior).epsilon(1e-5));
    });
  }

  TEST_CASE("the correction's cost by the prior is that of the estimate, however few the passes") {
    test::for_all(50, [](Rng& rng, int) {
      const Matrix4 P = covariance_of(rng);
      LinearMeasurement z = measurement_of(rng);
      for (const Index passes : {1, 2, 5}) {
        CAPTURE(passes);
        LinearFilter filter(R4d(), P);
        const FilterReport<R4d> report = filter.update(z, {.max_iterations = passes});
        const double by_prior = report.correction.dot(P.inverse() * report.correction);
        CHECK(report.prior_error == doctest::Approx(by_prior).epsilon(1e-5));
      }
    });
  }

  TEST_CASE("a pose by landmarks: prediction and guess lead to the same maximum a posteriori, where the cost is flat") {
    test::for_all(50, [](Rng& rng, int) {
      Landmarks z{.variance = 0.01};
      const Pose prediction = moved(Pose(), rng, 1, 1);
      const Pose truth = moved(prediction, rng, 0.5, 0.2);
      for (int i = 0; i < 4; ++i) {
        z.places.push_back(any_vector(rng, 5));
        z.seen.push_back(truth.get<1>().inverse() * Eigen::Vector3d(z.places.back() - truth.get<0>().value()) +
                         any_vector(rng, 0.1));
      }
      PoseFilter::Matrix P = 0.04 * PoseFilter::Matrix::Identity();
      P(0, 5) = P(5, 0) = 0.02;
      PoseFilter from_prediction(prediction, P), from_guess(prediction, P);
      const IterationRule rule{.max_iterations = 50, .step_tolerance = 1e-9};
      const FilterReport<Pose> expected = from_prediction.update(z, rule);
      const FilterReport<Pose> found = from_guess.update(z, rule, moved(prediction, rng, 1, 0.3));
      REQUIRE(expected.status == FilterStatus::converged);
      REQUIRE(found.status == FilterStatus::converged);
      CHECK(from_prediction.state().local(from_guess.state()).norm() < 1e-7);
      CHECK((from_prediction.covariance() - from_guess.covariance()).norm() < 1e-7);
      CHECK(found.prior_error == doctest::Approx(expected.prior_error).epsilon(1e-4));
      const PoseFilter::Matrix information = P.inverse();
      const auto cost = [&](const Pose& x) {
        const Pose::Tangent d = prediction.local(x);
        return Rn<double, 1>(Eigen::Matrix<double, 1, 1>(d.dot(information * d) + z.squared_error(x)));
      };
      CHECK(numeric_jacobian(cost, from_guess.state()).norm() < 1e-4 * information.norm());
    });
  }
}
