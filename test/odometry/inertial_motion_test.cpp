#include "chainslam/odometry/detail/inertial_motion.hpp"

#include <doctest/doctest.h>

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "odometry/imu_samples.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

constexpr double begin_time = 100, interval = 0.2;  // seconds
const Eigen::Vector3d turning(0.1, -0.2, 0.5), acceleration(1, 0.5, -0.3), speed(12, 1, 0.2);

/// Turning evenly, with an even acceleration in odom.
SO3d attitude(double t) { return SO3d::exp(t * turning); }
Eigen::Vector3d velocity(double t) { return speed + t * acceleration; }
Eigen::Vector3d place(double t) { return t * speed + 0.5 * t * t * acceleration; }

/// Puts the filter where scans would have, with so much doubt of all of the pose and the velocity.
void put(detail::InertialMotion& motion, double t, double deviation = 0.01) {
  InertialState x = motion.state();
  x.get<Inertial::position>() = R3d(place(t));
  x.get<Inertial::rotation>() = attitude(t);
  x.get<Inertial::velocity>() = R3d(velocity(t));
  InertialState::Jacobian covariance = motion.filter().covariance();
  for (int i = 0; i < 9; ++i)
    for (int j = 0; j < InertialState::dof; ++j)
      covariance(i, j) = covariance(j, i) = i == j ? deviation * deviation : 0;
  motion.filter().reset(x, covariance);
}

/// Measured from `start` on, with errors; half of a second more than is needed.
struct Errors {
  Eigen::Vector3d gyro = Eigen::Vector3d::Zero(), accel = Eigen::Vector3d::Zero();
};
detail::InertialMotion moving(const Errors& errors = {}, double gap_from = 1e9,
                              const InertialMotionOptions& options = {}) {
  detail::InertialMotion motion(options);
  motion.start(at(begin_time));
  put(motion, 0);
  for (int i = 0; i <= 70; ++i) {
    const double t = 0.01 * i;
    if (t > gap_from) continue;
    const Eigen::Vector3d felt =
        attitude(t).inverse() * Eigen::Vector3d(acceleration + 9.81 * Eigen::Vector3d::UnitZ());
    motion.add(sample_at(begin_time + t, turning + errors.gyro, felt + errors.accel));
  }
  return motion;
}

/// A position by itself.
struct Place {
  Eigen::Vector3d place;
  double variance = 1e-6;
  Linearization<InertialState> linearize(const InertialState& x, bool) const {
    const Eigen::Vector3d r = x.get<Inertial::position>().value() - place;
    Linearization<InertialState> sum;
    for (int i = 0; i < 3; ++i) {
      sum.information(i, i) = 1 / variance;
      sum.gradient[i] = -r[i] / variance;
    }
    sum.squared_error = r.squaredNorm() / variance;
    sum.residuals = 3;
    return sum;
  }
};

}  // namespace

TEST_SUITE("odometry/inertial_motion") {
  TEST_CASE("what an IMU without errors measured agrees with the scans") {
    detail::InertialMotion motion = moving();
    motion.predict(at(begin_time + interval));
    CHECK((motion.state().get<Inertial::position>().value() - place(interval)).norm() < 1e-4);
    put(motion, interval);
    const detail::ImuComparison comparison = motion.comparison();
    CHECK(comparison.interval == doctest::Approx(interval));
    CHECK(comparison.force_measured);
    CHECK(comparison.rate_error.norm() < 1e-6);
    CHECK((comparison.up - 9.81 * Eigen::Vector3d::UnitZ()).norm() < 1e-3);
    CHECK((comparison.up - comparison.expected_up).norm() < 1e-3);
    const Eigen::Vector3d force = acceleration + 9.81 * Eigen::Vector3d::UnitZ();
    CHECK((comparison.force - force).norm() < 1e-3);
    CHECK((comparison.force_way - 0.5 * interval * interval * force).norm() < 1e-4);
  }

  TEST_CASE("predictions take the accelerometer's noise for what has been learnt of it, and at least for its own") {
    const auto velocity_variance = [](double start, double own, ImuUse use = ImuUse::all) {
      InertialMotionOptions options;
      options.accel_noise.start = start;
      options.process.noise.accel = own;
      options.start_accel_bias = 0;
      detail::InertialMotion motion = moving({}, 1e9, options);
      InertialState::Jacobian known = zeros<InertialState::Jacobian>();  // all else is certain
      motion.filter().reset(motion.state(), known);
      CHECK(motion.accel_noise() == doctest::Approx(std::max(start, own)).scale(0));
      motion.predict(at(begin_time + interval), use);
      return motion.filter().covariance()(inertial_offset<Inertial::velocity>, inertial_offset<Inertial::velocity>);
    };
    const double own = velocity_variance(0, 0.02);
    CHECK(velocity_variance(0.01, 0.02) == doctest::Approx(own).scale(0).epsilon(1e-9));
    // The readings' change adds a little of its own to both.
    CHECK(velocity_variance(0.3, 0.02) - own ==
          doctest::Approx(interval * (0.3 * 0.3 - 0.02 * 0.02)).scale(0).epsilon(0.01));
    CHECK(velocity_variance(0.3, 0.02, ImuUse::gyroscope) ==
          doctest::Approx(velocity_variance(0, 0.02, ImuUse::gyroscope)).scale(0).epsilon(1e-3));
  }

  TEST_CASE("errors of the gyroscope and the accelerometer are found apart") {
    const Eigen::Vector3d gyro_error(0.02, -0.03, 0.05), accel_error(0.5, 1, -0.7);
    detail::InertialMotion gyro = moving({.gyro = gyro_error}), accel = moving({.accel = accel_error});
    for (detail::InertialMotion* motion : {&gyro, &accel}) {
      motion->predict(at(begin_time + interval));
      put(*motion, interval);
    }
    CHECK((gyro.comparison().rate_error - gyro_error).norm() < 2e-3);
    CHECK((gyro.comparison().up - gyro.comparison().expected_up).norm() < 1e-3);
    CHECK(accel.comparison().rate_error.norm() < 1e-6);
    const Eigen::Vector3d in_odom = attitude(0.5 * interval) * accel_error;
    CHECK((accel.comparison().up - accel.comparison().expected_up - in_odom).norm() < 2e-3);
  }

  TEST_CASE("nothing is compared where measurements are missing, or scans have not told the velocity") {
    detail::InertialMotion gap = moving({}, 0.1);
    gap.predict(at(begin_time + 0.5));
    put(gap, 0.5);
    CHECK(gap.comparison().interval == 0);
    detail::InertialMotion unknown = moving();
    put(unknown, 0, 3);  // m/s
    unknown.predict(at(begin_time + interval));
    put(unknown, interval);
    CHECK(unknown.comparison().interval == 0);
    detail::InertialMotion still_unknown = moving();
    still_unknown.predict(at(begin_time + interval));
    put(still_unknown, interval, 3);
    CHECK(still_unknown.comparison().interval == 0);
  }

  TEST_CASE(
      "predicted again with less: without the accelerometer the velocity stays, without the IMU the turn does too") {
    detail::InertialMotion motion = moving();
    motion.predict(at(begin_time + interval));
    put(motion, interval);
    motion.follow();  // by which the rate is known
    motion.predict(at(begin_time + 2 * interval));
    const InertialState by_all = motion.state();

    motion.predict_again(ImuUse::gyroscope);
    CHECK(motion.use() == ImuUse::gyroscope);
    CHECK(motion.time() == at(begin_time + 2 * interval));
    CHECK((motion.state().get<Inertial::velocity>().value() - velocity(interval)).norm() < 1e-9);
    CHECK((motion.state().get<Inertial::position>().value() - place(interval) - interval * velocity(interval)).norm() <
          1e-9);
    CHECK(by_all.get<Inertial::rotation>().local(motion.state().get<Inertial::rotation>()).norm() < 1e-9);

    motion.predict_again(ImuUse::none);
    CHECK(motion.measured_share() == 0);
    CHECK((motion.state().get<Inertial::velocity>().value() - velocity(interval)).norm() < 1e-9);
    CHECK(attitude(2 * interval).local(motion.state().get<Inertial::rotation>()).norm() < 1e-3);  // at the rate before

    motion.predict_again(ImuUse::all);
    CHECK(motion.measured_share() == doctest::Approx(1));
    CHECK(by_all.local(motion.state()).norm() < 1e-12);
  }

  TEST_CASE("what was learnt from a sensor that is not believed is as uncertain as at the start") {
    detail::InertialMotion motion = moving();
    const InertialMotionOptions defaults;
    InertialState::Jacobian covariance = motion.filter().covariance();
    for (int i = inertial_offset<Inertial::gyro_bias>; i < inertial_offset<Inertial::up> + 2; ++i)
      covariance(i, i) = 1e-8;
    motion.filter().reset(motion.state(), covariance);
    motion.predict(at(begin_time + interval));
    const auto deviation = [&](int i) { return std::sqrt(motion.filter().covariance()(i, i)); };
    constexpr int gyro = inertial_offset<Inertial::gyro_bias>, accel = inertial_offset<Inertial::accel_bias>;
    constexpr int up = inertial_offset<Inertial::up>;
    CHECK(deviation(accel) < 0.1 * defaults.start_accel_bias);
    motion.predict_again(ImuUse::gyroscope);
    CHECK(deviation(accel) >= 0.99 * defaults.start_accel_bias);
    CHECK(deviation(up) >= 0.99 * defaults.start_up);
    CHECK(deviation(gyro) < 0.1 * defaults.start_gyro_bias);  // it is still believed
    motion.predict_again(ImuUse::none);
    CHECK(deviation(gyro) >= 0.99 * defaults.start_gyro_bias);
  }

  TEST_CASE(
      "in doubt of the motion, a scan that lies elsewhere changes the velocity by its distance over the interval") {
    for (const double distance : {0.5, 1.5}) {
      detail::InertialMotion motion = moving();
      motion.predict(at(begin_time + interval));
      const InertialState predicted = motion.state();
      motion.doubt_motion();
      CHECK(predicted.local(motion.state()).norm() == 0);
      const Eigen::Vector3d off = distance * Eigen::Vector3d(0.8, -0.6, 0);
      Place measured{.place = predicted.get<Inertial::position>().value() + off};
      CHECK(motion.filter().update(measured).accepted());
      const Eigen::Vector3d gained =
          motion.state().get<Inertial::velocity>().value() - predicted.get<Inertial::velocity>().value();
      CHECK((gained - off / interval).norm() < 0.02 * off.norm() / interval);
      // Without doubt, the same scan is taken for an acceleration that gravity's direction has hidden, and the velocity
      // at the end is off by twice as much.
      detail::InertialMotion sure = moving();
      sure.predict(at(begin_time + interval));
      CHECK(sure.filter().update(measured).accepted());
      const Eigen::Vector3d more =
          sure.state().get<Inertial::velocity>().value() - predicted.get<Inertial::velocity>().value();
      CHECK(more.norm() > 1.5 * gained.norm());
    }
  }

  TEST_CASE("a guess that is moved is as much faster") {
    detail::InertialMotion motion = moving();
    motion.predict(at(begin_time + interval));
    Vector6d step = Vector6d::Zero();
    step[0] = 0.4;  // forward, in the body's axes
    const InertialState moved = motion.moved(step);
    const Eigen::Vector3d way =
        moved.get<Inertial::position>().value() - motion.state().get<Inertial::position>().value();
    CHECK(way.norm() == doctest::Approx(0.4));
    const Eigen::Vector3d gained =
        moved.get<Inertial::velocity>().value() - motion.state().get<Inertial::velocity>().value();
    CHECK((gained - way / interval).norm() < 1e-9);
    CHECK(motion.moved(Vector6d::Zero()).local(motion.state()).norm() < 1e-12);
  }

  TEST_CASE("quiet measurements are of rest or of a slow turn: the bias at the start allows for both") {
    const Eigen::Vector3d mean(0.002, -0.001, 0.02);  // rad/s
    detail::InertialMotion motion;
    for (int i = 0; i < 100; ++i) motion.add(sample_at(begin_time - 1 + 0.01 * i, mean));
    REQUIRE(motion.start(at(begin_time)).at_rest);
    constexpr int bias = inertial_offset<Inertial::gyro_bias>;
    const Eigen::Vector3d found = motion.state().get<Inertial::gyro_bias>().value();
    const Eigen::Matrix3d covariance = motion.filter().covariance().block<3, 3>(bias, bias);
    for (const Eigen::Vector3d& truth : {mean, Eigen::Vector3d(0, 0, 0)}) {
      const Eigen::Vector3d off = found - truth;
      CHECK(off.dot(covariance.inverse() * off) < 1.01);
    }
    // In a turn the bias may be anything, also about axes that are not turned about.
    const InertialMotionOptions options;
    const Eigen::Vector3d across = mean.unitOrthogonal();
    CHECK(std::sqrt(across.dot(covariance * across)) > 0.7 * options.start_gyro_bias);
    CHECK(std::sqrt(across.dot(covariance * across)) < options.start_gyro_bias);
  }

  TEST_CASE("what was measured of the mounting is told without what was assumed of it") {
    InertialMotionOptions options;
    detail::InertialMotion motion(options, SE3d(SO3d::exp({0.1, 0.2, 0.3}), {1, 0, 0}));
    motion.start(at(begin_time));
    CHECK(motion.mounting_evidence().information.norm() == 0);  // held
    motion.doubt_mounting();
    CHECK(motion.mounting_evidence().information.norm() < 1e-3);
    // A measurement of the rotation by 0.002 rad about x and 0.01 rad about y: nothing is seen of z.
    constexpr int first = inertial_offset<Inertial::lidar_rotation>;
    const Eigen::Vector3d measured(0.004, -0.008, 0);
    const Eigen::Vector3d information(1 / (0.002 * 0.002), 1 / (0.01 * 0.01), 0);
    InertialState x = motion.state();
    InertialState::Jacobian covariance = motion.filter().covariance();
    Eigen::Vector3d step = Eigen::Vector3d::Zero();
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < InertialState::dof; ++j) covariance(first + i, j) = covariance(j, first + i) = 0;
      covariance(first + i, first + i) = 1 / (information[i] + 1 / (options.lidar_rotation * options.lidar_rotation));
      step[i] = covariance(first + i, first + i) * information[i] * measured[i];
    }
    x.get<Inertial::lidar_rotation>() = x.get<Inertial::lidar_rotation>().retract(step);
    motion.filter().reset(x, covariance);
    const RotationEvidence evidence = motion.mounting_evidence();
    CHECK((evidence.information.diagonal() - information).norm() < 1e-6 * information.norm());
    CHECK((evidence.vector - information.cwiseProduct(measured)).norm() < 1e-3 * evidence.vector.norm());
    CHECK(evidence.about.local(SO3d::exp({0.1, 0.2, 0.3})).norm() < 1e-12);
  }
}
