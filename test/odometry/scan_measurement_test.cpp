#include "chainslam/odometry/detail/scan_measurement.hpp"

#include <doctest/doctest.h>

#include <Eigen/LU>
#include <Eigen/QR>
#include <cmath>
#include <optional>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/lie/jacobians.hpp"
#include "chainslam/odometry/ieskf.hpp"
#include "chainslam/odometry/imu_process.hpp"
#include "chainslam/odometry/lidar_inertial_options.hpp"
#include "chainslam/search/brute_force.hpp"
#include "odometry/inertial_trip.hpp"
#include "support/quick.hpp"
#include "support/world.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

using State = InertialState;
using StateMatrix = State::Jacobian;
using Matrix = Eigen::MatrixXd;  // of any size: expressions of 26 x 26 matrices take seconds to compile
using StateVector = State::Tangent;

/// Points of the hall's walls, floor and pillars, seen from a pose.
std::vector<Eigen::Vector3f> hall_points(const SE3d& T_world_lidar, int columns, Rng& rng) {
  const Spinner spinner{.rings = 16, .columns = columns, .timed = false};
  return spinner
      .sweep(
          hall(), 0, [&](double) { return T_world_lidar; }, rng)
      .cloud.positions;
}

/// FAST-LIO2's filter as its paper writes it (Xu et al. 2022), without regard to cost: eq. 1 to 3 and 7 to 8 for the
/// propagation, algorithm 1 with eq. 14 to 20 for the update, every matrix written out and inverted, neighbours by
/// looking at every point, planes by a QR factorization of a . p = -1 (its code's gates), Jacobians of the manifold
/// by numbers.
struct LiteralFastLio2 {
  State x;
  StateMatrix P;

  void propagate(const ImuInput& u, double dt) {
    const auto f = [&](const State& s, const Eigen::Matrix<double, 12, 1>& w) {
      const SO3d R = s.get<Inertial::rotation>();
      const Eigen::Vector3d a = R * Eigen::Vector3d(u.accel - s.get<Inertial::accel_bias>().value() - w.segment<3>(3)) -
                                9.81 * s.get<Inertial::up>().direction();
      StateVector rate = StateVector::Zero();
      rate.segment<3>(0) = s.get<Inertial::velocity>().value() + 0.5 * dt * a;
      rate.segment<3>(3) = u.gyro - s.get<Inertial::gyro_bias>().value() - w.head<3>();
      rate.segment<3>(6) = a;
      rate.segment<6>(9) = w.tail<6>();
      return rate;
    };
    using Noise = Eigen::Matrix<double, 12, 1>;
    const Noise none = Noise::Zero();
    const Matrix F_x = numeric_jacobian([&](const State& s) { return s.retract(dt * f(s, none)); }, x);
    const Matrix F_w = numeric_jacobian([&](const Noise& w) { return x.retract(dt * f(x, w)); }, none);
    const ImuNoise density = fast_lio2().process.noise;
    Eigen::VectorXd variances(12);
    variances << Eigen::Vector3d::Constant(density.gyro * density.gyro),
        Eigen::Vector3d::Constant(density.accel * density.accel),
        Eigen::Vector3d::Constant(density.gyro_bias_walk * density.gyro_bias_walk),
        Eigen::Vector3d::Constant(density.accel_bias_walk * density.accel_bias_walk);
    x = x.retract(dt * f(x, none));
    P = F_x * Matrix(P) * F_x.transpose() + F_w * Matrix(variances.asDiagonal()) * F_w.transpose();
  }

  struct Row {
    Eigen::Vector3f normal, anchor;
  };

  [[nodiscard]] static std::optional<Row> plane_at(const BruteForce<float>& map, const Eigen::Vector3d& p) {
    std::array<Neighbor<float>, 5> near;
    if (map.knn(Eigen::Vector3f(p.cast<float>()), near, 2.236F) < 5) return std::nullopt;
    Matrix A(5, 3);
    for (int i = 0; i < 5; ++i) A.row(i) = map.position(near[static_cast<std::size_t>(i)].index).cast<double>();
    const Eigen::Vector3d a = A.colPivHouseholderQr().solve(Eigen::VectorXd::Constant(5, -1));
    const Eigen::Vector3d n = a.normalized();
    const double offset = 1 / a.norm();
    if (((A * n).array() + offset).abs().maxCoeff() > 0.1) return std::nullopt;
    return Row{n.cast<float>(), (-offset * n).cast<float>()};  // its code keeps planes in float, too
  }

  /// Returns the number of passes.
  int update(const BruteForce<float>& map, const std::vector<Eigen::Vector3f>& scan) {
    const State prediction = x;
    std::vector<std::optional<Row>> planes;
    StateMatrix posterior = P;
    bool renew = true;
    int pass = 0;
    for (; pass < 5; ++pass) {
      const SE3d T = T_odom_body(x) * T_body_lidar(x) * T_body_lidar(prediction).inverse();
      if (renew) {
        planes.clear();
        for (const auto& p : scan) planes.push_back(plane_at(map, T * Eigen::Vector3d(p.cast<double>())));
      }
      std::vector<double> z;
      std::vector<StateVector> rows;
      for (std::size_t i = 0; i < scan.size(); ++i) {
        if (!planes[i]) continue;
        const Eigen::Vector3d n = planes[i]->normal.cast<double>(), p = scan[i].cast<double>();
        const double residual = n.dot(T * p - planes[i]->anchor.cast<double>());
        if (!(1 - 0.9 * std::abs(residual) / std::sqrt(p.norm()) > 0.9)) continue;
        // d r / d x by hand: r = n . (R (R_L q + t_L) + t), q the point in the LiDAR's frame.
        const Eigen::Matrix3d R = x.get<Inertial::rotation>().matrix(),
                              R_L = x.get<Inertial::lidar_rotation>().matrix();
        const Eigen::Vector3d q = T_body_lidar(prediction).inverse() * p;
        const Eigen::Vector3d body = T_body_lidar(x) * q;
        StateVector row = StateVector::Zero();
        row.segment<3>(0) = n;
        row.segment<3>(3) = -(n.transpose() * R * SO3d::hat(body)).transpose();
        row.segment<3>(inertial_offset<Inertial::lidar_position>) = (n.transpose() * R).transpose();
        row.segment<3>(inertial_offset<Inertial::lidar_rotation>) =
            -(n.transpose() * R * R_L * SO3d::hat(q)).transpose();
        rows.push_back(row);
        z.push_back(residual);
      }
      Matrix H(static_cast<Eigen::Index>(rows.size()), State::dof);
      for (std::size_t i = 0; i < rows.size(); ++i) H.row(static_cast<Eigen::Index>(i)) = rows[i];
      const Eigen::Map<const Eigen::VectorXd> residuals(z.data(), static_cast<Eigen::Index>(z.size()));
      // J of eq. 16: d ((x (+) d) (-) prediction) / d d
      const StateVector ahead = prediction.local(x);
      using Coordinates = Rn<double, State::dof>;
      const Matrix J = numeric_jacobian(
          [&](const Coordinates& d) { return Coordinates(prediction.local(x.retract(d.value()))); }, Coordinates());
      const Matrix J_inverse = J.inverse(), P_here = J_inverse * Matrix(P) * J_inverse.transpose();
      const double R_inverse = 1 / 0.001;
      const Matrix K =
          (H.transpose() * R_inverse * H + P_here.inverse()).inverse() * H.transpose() * R_inverse;  // eq. 20
      const Matrix gained = Matrix::Identity(State::dof, State::dof) - K * H;
      const StateVector step = -K * residuals - gained * (J_inverse * ahead);  // eq. 18
      const State here = x;
      x = x.retract(step);
      const Matrix reset = numeric_jacobian(
          [&](const Coordinates& d) { return Coordinates(x.local(here.retract(step + d.value()))); }, Coordinates());
      posterior = reset * gained * P_here * reset.transpose();  // eq. 19, as its code does it
      const bool small = step.cwiseAbs().maxCoeff() < 1e-3;
      const bool was_fresh = renew;
      renew = small || pass + 2 == 5;
      if (small && was_fresh) {
        ++pass;
        break;
      }
    }
    P = posterior;
    return pass;
  }
};

}  // namespace

TEST_SUITE("odometry/scan_measurement") {
  TEST_CASE("the scan's pose changes with the state as its Jacobian says") {
    Rng rng(31);
    const auto any = [&] {
      StateVector d;
      for (auto& value : d) value = rng.normal(0, 0.3);
      return State().retract(d);
    };
    const BruteForce<float> map;
    const std::vector<Eigen::Vector3f> scan;
    const ScanToMap<> rule;
    const detail::ScanMeasurement measurement(scan, map, rule, {}, {.state = any(), .mean_age = 0.05}, Serial{});
    const State x = any();
    const auto numeric = numeric_jacobian([&](const State& y) { return measurement.pose(y); }, x);
    CHECK((measurement.pose_jacobian(x) - numeric).cwiseAbs().maxCoeff() < 1e-9);
  }

  TEST_CASE("a scan that was taken later than stated lies ahead, and leaves the state where it is") {
    Rng rng(33);
    std::vector<Eigen::Vector3f> surface = hall_points({}, 360, rng);
    for (const auto& p : hall_points(SE3d(SO3d(), {3, 0.5, 0.2}), 360, rng))
      surface.push_back((SE3d(SO3d(), {3, 0.5, 0.2}) * Eigen::Vector3d(p.cast<double>())).cast<float>());
    const BruteForce<float> map(surface);
    State x;
    x.get<Inertial::velocity>() = R3d(Eigen::Vector3d(6, -2, 0.3));
    const detail::MomentaryMotion motion{.velocity = {6, -2, 0.3}, .rate = {0.1, -0.2, 0.8}};
    constexpr double late = 0.025;
    const SE3d taken_at = motion.later(T_odom_body(x), late);
    const std::vector<Eigen::Vector3f> scan = hall_points(taken_at, 90, rng);
    StateVector variances = StateVector::Constant(1e-8);
    variances.head<6>().setConstant(1e-5);
    const LidarInertialOdometryOptions<> options;
    const auto update = [&](double deviation, const auto& check) {
      Ieskf<State, ImuProcess> filter(x, variances.asDiagonal());
      detail::ScanMeasurement measurement(
          scan, map, options.scan_to_map, {},
          {.state = x, .error = 0.3, .mean_age = 0.05, .time_deviation = deviation, .rate = motion.rate}, Serial{});
      REQUIRE(filter.update(measurement, options.iteration).status == FilterStatus::converged);
      check(measurement, T_odom_body(filter.state()), measurement.time_error(filter.state()));
    };
    update(0.02, [&](auto& measurement, const SE3d& T, double time_error) {
      CHECK(std::abs(time_error - late) < 1e-3);
      CHECK(T.translation().norm() < 0.01);
      CHECK(T.log().tail<3>().norm() < 1e-3);
      const Vector6d off = measurement.pose(x).local(taken_at);
      CHECK(off.head<3>().norm() < 0.01);
      CHECK(off.tail<3>().norm() < 2e-3);
      // The derivatives at a time error that is not zero.
      const auto numeric = numeric_jacobian([&](const State& y) { return measurement.pose(y); }, x);
      CHECK((measurement.pose_jacobian(x) - numeric).cwiseAbs().maxCoeff() < 1e-8);
      constexpr double h = 1e-5;
      const SE3d before = motion.later(measurement.pose(x), -h), after = motion.later(measurement.pose(x), h);
      CHECK((measurement.pose_by_time(x) - before.local(after) / (2 * h)).norm() < 1e-6);
    });
    update(0, [&](auto&, const SE3d& T, double time_error) {
      CHECK(time_error == 0);
      CHECK(T.translation().norm() > 0.02);
    });
  }

  TEST_CASE("FAST-LIO2's preset takes each of a hundred steps as its equations, written out, do") {
    const FastLio2Rules preset = fast_lio2();
    const int frames = quick() ? 10 : 100;
    Rng rng(32);
    std::vector<Eigen::Vector3f> surface = hall_points({}, 180, rng);
    for (const double x : {-4.0, 5.0}) {
      const SE3d pose(SO3d(), {x, 1, 0.4});
      for (const auto& p : hall_points(pose, 180, rng))
        surface.push_back((pose * Eigen::Vector3d(p.cast<double>())).cast<float>());
    }
    const BruteForce<float> map(surface);

    const InertialTrip trip{.pose = [](double t) {
      return SE3d(SO3d::exp({0.1 * std::sin(t), 0.1 * std::sin(2 * t), 0.3 * std::sin(t)}),
                  {std::sin(t), 0.5 * std::sin(2 * t), 0.2 * std::sin(t)});
    }};
    State x;
    x.get<Inertial::velocity>() = R3d(Eigen::Vector3d(1, 1, 0.2));
    x.get<Inertial::lidar_position>() = R3d(Eigen::Vector3d(0.1, -0.2, 0.3));
    const SE3d mount = T_body_lidar(x);
    StateVector variances = StateVector::Constant(1e-4);
    variances.segment<3>(6).setConstant(0.1);
    variances[inertial_offset<Inertial::bend>] = 1e-20;  // none, but what is written out is inverted
    Ieskf<State, ImuProcess> filter(x, variances.asDiagonal(), preset.process);
    double worst = 0, worst_covariance = 0;
    Index corrected = 0;
    for (int frame = 1; frame <= frames; ++frame) {
      LiteralFastLio2 literal{filter.state(), filter.covariance()};
      for (int i = 0; i < 5; ++i) {
        const ImuSample felt = trip.felt(0.1 * (frame - 1) + 0.02 * i + 0.01);
        const ImuInput u{.gyro = felt.gyro + Eigen::Vector3d(0.01, -0.02, 0.01), .accel = felt.accel};
        filter.predict(u, 0.02);
        literal.propagate(u, 0.02);
      }
      std::vector<Eigen::Vector3f> scan;
      for (const auto& p : hall_points(trip.pose(0.1 * frame) * mount, 20, rng))
        scan.push_back((mount * Eigen::Vector3d(p.cast<double>())).cast<float>());
      detail::ScanMeasurement measurement(scan, map, preset.scan_to_map, preset.scan,
                                          {.state = filter.state(), .variance = preset.variance}, Serial{});
      const auto report = filter.update(measurement, preset.iteration);
      corrected += report.accepted() ? 1 : 0;
      CHECK(report.iterations == literal.update(map, scan));
      worst = std::max(worst, literal.x.local(filter.state()).cwiseAbs().maxCoeff());
      worst_covariance = std::max(worst_covariance, (literal.P - filter.covariance()).cwiseAbs().maxCoeff());
    }
    MESSAGE("largest difference of a step: state ", worst, ", covariance ", worst_covariance);
    CHECK(corrected == frames);
    CHECK(worst < 1e-5);  // residuals are sums of floats
    CHECK(worst_covariance < 1e-9);
  }
}
