#include "chainslam/odometry/imu_process.hpp"

#include <doctest/doctest.h>

#include <array>
#include <cmath>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/lie/jacobians.hpp"
#include "chainslam/odometry/ieskf.hpp"
#include "support/property.hpp"
#include "support/quick.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

using InertialTangent = InertialState::Tangent;
using InertialMatrix = InertialState::Jacobian;

InertialTangent inertial_noise(Rng& rng, double deviation) {
  InertialTangent d;
  for (auto& value : d) value = rng.normal(0, deviation);
  return d;
}
Eigen::Vector3d noise3(Rng& rng, double deviation) {
  return {rng.normal(0, deviation), rng.normal(0, deviation), rng.normal(0, deviation)};
}
ImuInput imu_input(Rng& rng) { return {.gyro = noise3(rng, 1), .accel = noise3(rng, 5)}; }

/// Landmarks seen from the LiDAR, each of its three coordinates with white noise.
struct Landmarks {
  std::vector<Eigen::Vector3d> map, seen;
  double deviation;

  Linearization<InertialState> linearize(const InertialState& x, bool) const {
    Linearization<InertialState> sum;
    const SE3d T_lidar_odom = (T_odom_body(x) * T_body_lidar(x)).inverse();
    const auto pose_jacobian = lidar_pose_jacobian(x);
    for (std::size_t i = 0; i < map.size(); ++i) {
      const Eigen::Vector3d q = T_lidar_odom * map[i];
      Eigen::Matrix<double, 3, 6> by_pose;
      by_pose << -Eigen::Matrix3d::Identity(), SO3d::hat(q);
      const Eigen::Matrix<double, 3, InertialState::dof> H = by_pose * pose_jacobian / deviation;
      const Eigen::Vector3d r = (q - seen[i]) / deviation;
      sum.information += H.transpose() * H;
      sum.gradient -= H.transpose() * r;
      sum.squared_error += r.squaredNorm();
      sum.residuals += 3;
    }
    return sum;
  }
};

/// Standard deviations at the start of the known-map problem, in the order of the state.
InertialTangent start_deviation() {
  InertialTangent d;
  const std::array<std::pair<int, double>, 10> parts{
      {{3, 0.3}, {3, 0.05}, {3, 0.5}, {3, 0.01}, {3, 0.1}, {2, 0.02}, {2, 0.01}, {1, 0.01}, {3, 0.05}, {3, 0.02}}};
  int at = 0;
  for (const auto& [size, deviation] : parts) {
    d.segment(at, size).setConstant(deviation);
    at += size;
  }
  return d;
}

struct Consistency {
  double nees;           ///< of the last state, its degrees of freedom on average
  double nis_per_three;  ///< of the updates after the third, over a third of the residuals: 3 on average
};

/// A flight of two seconds among known landmarks: noise is what the filter takes it to be.
Consistency fly_among_landmarks(Rng& rng) {
  const ImuProcess process;
  const InertialTangent deviation = start_deviation();
  const auto start = InertialState().retract(inertial_noise(rng, 0.3));
  InertialTangent error = inertial_noise(rng, 1).cwiseProduct(deviation);
  InertialState truth = start.retract(error);
  // The filter's own state is the mean from which the truth was drawn.
  Ieskf<InertialState, ImuProcess> filter(start, deviation.cwiseAbs2().asDiagonal(), process);
  Landmarks landmarks{{}, {}, 0.03};
  for (int i = 0; i < 5; ++i) landmarks.map.push_back(noise3(rng, 10));
  constexpr double dt = 0.01;
  double nis = 0, count = 0;
  for (int step = 1; step <= 200; ++step) {
    const double t = step * dt;
    const Eigen::Vector3d rate(std::sin(3 * t), 0.5 * std::cos(2 * t), 0.8);
    const Eigen::Vector3d force(std::cos(t), 2 * std::sin(4 * t), 9.81);
    const ImuInput reading{.gyro = rate, .accel = force};
    const auto moved = process.predict(truth, reading, dt);
    const Eigen::LDLT<InertialMatrix> Q(moved.Q);
    const InertialTangent white = inertial_noise(rng, 1);
    const InertialTangent drawn =
        Q.transpositionsP().transpose() *
        InertialTangent(Q.matrixL() * InertialTangent(Q.vectorD().cwiseMax(0.0).cwiseSqrt().cwiseProduct(white)));
    truth = moved.state.retract(drawn);
    filter.predict(reading, dt);
    if (step % 20 != 0) continue;
    const SE3d T_lidar_odom = (T_odom_body(truth) * T_body_lidar(truth)).inverse();
    landmarks.seen.clear();
    for (const Eigen::Vector3d& p : landmarks.map) landmarks.seen.push_back(T_lidar_odom * p + noise3(rng, 0.03));
    const auto report = filter.update(landmarks, {.max_iterations = 10, .step_tolerance = 1e-6});
    CHECK(report.status == FilterStatus::converged);
    if (step <= 60) continue;  // until the state is known so well that the measurement is linear around it
    nis += report.nis;
    count += report.nis_residuals;
  }
  error = filter.state().local(truth);
  return {error.dot(filter.covariance().ldlt().solve(error)), 3 * nis / count};
}

}  // namespace

TEST_SUITE("odometry/imu_process") {
  TEST_CASE("Jacobians of both integrations are those of the numbers") {
    for_all(10, [](Rng& rng, int) {
      const auto x = InertialState().retract(inertial_noise(rng, 0.5));
      const ImuInput input = imu_input(rng);
      for (const auto integration : {ImuIntegration::midpoint, ImuIntegration::euler}) {
        const ImuProcess process{.integration = integration};
        const auto F =
            numeric_jacobian([&](const InertialState& y) { return process.predict(y, input, 0.05).state; }, x);
        CHECK((process.predict(x, input, 0.05).F - F).cwiseAbs().maxCoeff() < 1e-9);
      }
      const auto pose_jacobian =
          numeric_jacobian([](const InertialState& y) { return T_odom_body(y) * T_body_lidar(y); }, x);
      CHECK((lidar_pose_jacobian(x) - pose_jacobian).cwiseAbs().maxCoeff() < 1e-9);
    });
  }

  TEST_CASE("midpoint steps follow a turn to second order, Euler's to first") {
    // Once around a circle of 2 m in 4 s, against the closed form.
    const double rate = std::numbers::pi / 2, speed = 2 * rate;
    const ImuInput turning{.gyro = {0, 0, rate}, .accel = {0, speed * rate, 9.81}};
    const auto error = [&](ImuIntegration integration, int steps) {
      const ImuProcess process{.integration = integration};
      InertialState x;
      x.get<Inertial::velocity>() = R3d(Eigen::Vector3d(speed, 0, 0));
      for (int i = 0; i < steps; ++i) x = process.predict(x, turning, 4.0 / steps).state;
      return x.get<Inertial::position>().value().norm();
    };
    CHECK(error(ImuIntegration::midpoint, 400) < 2e-3);
    CHECK(error(ImuIntegration::midpoint, 100) / error(ImuIntegration::midpoint, 200) > 3.8);
    CHECK(error(ImuIntegration::euler, 400) > 10 * error(ImuIntegration::midpoint, 400));
  }

  TEST_CASE("over a bent map up leans with the way, and tilt counts by how much") {
    InertialState x;
    x.get<Inertial::velocity>() = R3d(Eigen::Vector3d(3, 4, 0));
    x.get<Inertial::bend>() = R1d(R1d::Tangent(1e-3));
    const Eigen::Vector3d lying = x.get<Inertial::up>().direction();
    for (int i = 0; i < 100; ++i) x = ImuProcess{}.predict(x, {.accel = {0, 0, 9.81}}, 0.01).state;
    // It leans by five thousandths of a radian, which then tell as a force: half a tenth of m/s^2.
    const Eigen::Vector3d moved = x.get<Inertial::up>().direction() - lying;
    CHECK(moved.x() == doctest::Approx(3e-3).epsilon(0.01));
    CHECK(moved.y() == doctest::Approx(4e-3).epsilon(0.01));
    CHECK((moved.head<2>() - x.get<Inertial::tilt>().value()).norm() < 1e-12);
  }

  TEST_CASE("uncertainty grows with time, not with the rate of the unit; as cited it does with the rate") {
    const auto grown = [](ImuIntegration integration, int steps) {
      Ieskf<InertialState, ImuProcess> filter(InertialState(), InertialMatrix::Zero(), {.integration = integration});
      for (int i = 0; i < steps; ++i) filter.predict({.accel = {0, 0, 9.81}}, 1.0 / steps);
      return filter.covariance()(3, 3);
    };
    CHECK(grown(ImuIntegration::midpoint, 10) == doctest::Approx(grown(ImuIntegration::midpoint, 1000)).epsilon(1e-3));
    CHECK(grown(ImuIntegration::midpoint, 100) == doctest::Approx(4e-6).epsilon(1e-2));  // gyro^2 t
    CHECK(grown(ImuIntegration::euler, 10) > 50 * grown(ImuIntegration::euler, 1000));
  }

  TEST_CASE("a flight among known landmarks is as far off as the filter says" * doctest::skip(quick())) {
    constexpr int runs = 50;
    double nees = 0, nis = 0;
    for (int run = 0; run < runs; ++run) {
      Rng rng(static_cast<std::uint64_t>(100 + run));
      const Consistency consistency = fly_among_landmarks(rng);
      nees += consistency.nees / runs;
      nis += consistency.nis_per_three / runs;
    }
    constexpr int dof = InertialState::dof;
    MESSAGE("mean NEES ", nees, " of ", dof, ", NIS ", nis, " of 3 a landmark");
    // Bar-Shalom et al. 2001, section 5.4: runs * mean is chi-squared with dof * runs degrees of freedom.
    CHECK(nees > dof - 1.96 * std::sqrt(2.0 * dof / runs));
    CHECK(nees < dof + 1.96 * std::sqrt(2.0 * dof / runs));
    CHECK(nis == doctest::Approx(3).epsilon(1.96 * std::sqrt(2.0 / (runs * 7 * 15))));
  }
}
