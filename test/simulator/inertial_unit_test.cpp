#include "simulator/inertial_unit.hpp"

#include <doctest/doctest.h>

#include "simulator/preset.hpp"

namespace chainslam::simulator {
namespace {

Drive small_drive(std::uint64_t seed) {
  const Preset options = *preset("town-small");
  return Drive(options.drive, options.sessions[0].route, make_town(options.town, Rng(seed)), Rng(seed).fork(1));
}

struct State {
  SE3d T_map_body;
  Eigen::Vector3d velocity_map;
};

/// Strapdown integration, trapezoidal in rate and specific force.
State integrate(State state, const std::vector<ImuSample>& samples) {
  const Eigen::Vector3d down(0.0, 0.0, -gravity);
  for (std::size_t i = 0; i + 1 < samples.size(); ++i) {
    const double dt = to_seconds(samples[i + 1].time - samples[i].time);
    const SO3d before = state.T_map_body.rotation();
    const SO3d after = before * SO3d::exp(0.5 * dt * (samples[i].gyro + samples[i + 1].gyro));
    const Eigen::Vector3d acceleration = 0.5 * (before * samples[i].accel + after * samples[i + 1].accel) + down;
    const Eigen::Vector3d position =
        state.T_map_body.translation() + dt * state.velocity_map + 0.5 * dt * dt * acceleration;
    state = {SE3d(after, position), state.velocity_map + dt * acceleration};
  }
  return state;
}

}  // namespace

TEST_SUITE("simulator/inertial_unit") {
  TEST_CASE("a perfect unit integrates back to the truth") {
    const Drive drive = small_drive(1);
    const auto samples = record_imu(drive, InertialOptions{.rate = 100.0}.without_errors(), Timestamp(), Rng(1));
    const Motion start = drive.motion(0.0);
    const Motion end = drive.motion(to_seconds(samples.back().time - Timestamp()));
    const State result = integrate({start.T_map_body, start.velocity_map}, samples);
    // The trapezoid rule at 100 Hz against vibration of up to 10 Hz; 28 s of double integration.
    CHECK((result.T_map_body.rotation().inverse() * end.T_map_body.rotation()).log().norm() < 2e-3);
    CHECK((result.velocity_map - end.velocity_map).norm() < 0.1);
    CHECK((result.T_map_body.translation() - end.T_map_body.translation()).norm() < 1.0);

    // Ten times the rate: the error falls with the square of the step.
    const auto fine = record_imu(drive, InertialOptions{.rate = 1000.0}.without_errors(), Timestamp(), Rng(1));
    const State precise = integrate({start.T_map_body, start.velocity_map}, fine);
    const Motion last = drive.motion(to_seconds(fine.back().time - Timestamp()));
    CHECK((precise.T_map_body.translation() - last.T_map_body.translation()).norm() < 0.02);
    CHECK((precise.velocity_map - last.velocity_map).norm() < 2e-3);
  }

  TEST_CASE("the unit that is shipped drifts by metres, not by kilometres") {
    const Drive drive = small_drive(2);
    const auto samples = record_imu(drive, {}, Timestamp(), Rng(2));
    const Motion start = drive.motion(0.0);
    const State result = integrate({start.T_map_body, start.velocity_map}, samples);
    const double drift = (result.T_map_body.translation() - drive.pose(drive.duration()).translation()).norm();
    CHECK(drift > 1.0);
    CHECK(drift < 500.0);
  }

  TEST_CASE("noise, bias and scale have the stated size") {
    const Drive drive = small_drive(3);
    const InertialOptions options;
    const auto perfect = record_imu(drive, options.without_errors(), Timestamp(), Rng(1));
    double bias_squares = 0.0;
    double noise_squares = 0.0;
    constexpr int units = 40;
    std::size_t differences = 0;
    for (int unit = 0; unit < units; ++unit) {
      const auto samples = record_imu(drive, options, Timestamp(), Rng(100).fork(static_cast<std::uint64_t>(unit)));
      Eigen::Vector3d mean = Eigen::Vector3d::Zero();
      constexpr std::size_t resting = 190;  // the vehicle stands for 2 s: no scale error in the rates
      for (std::size_t i = 0; i < resting; ++i) mean += (samples[i].gyro - perfect[i].gyro) / resting;
      bias_squares += mean.squaredNorm() / 3.0;
      for (std::size_t i = 0; i + 1 < resting; ++i, ++differences)
        noise_squares += (samples[i + 1].gyro - samples[i].gyro).squaredNorm() / 6.0;
    }
    const double noise = std::sqrt(noise_squares / static_cast<double>(differences));
    CHECK(noise == doctest::Approx(options.gyro_noise * 10.0).epsilon(0.03));  // 22800 values: 0.5 %
    // 120 values: 6.5 %; the mean of 190 samples adds 0.36e-3 rad/s of noise.
    CHECK(std::sqrt(bias_squares / units) == doctest::Approx(options.gyro_bias).epsilon(0.2));
  }

  TEST_CASE("a unit keeps its scales and axes from day to day, not its bias and noise") {
    const Drive drive = small_drive(3);
    InertialOptions lasting = InertialOptions{}.without_errors();
    lasting.scale = InertialOptions{}.scale;
    lasting.misalignment_deg = InertialOptions{}.misalignment_deg;
    const auto accel = [&](const InertialOptions& options, std::size_t sample, Index day) {
      return record_imu(drive, options, Timestamp(), Rng(7), day)[sample].accel;
    };
    CHECK(accel(lasting, 900, 0) == accel(lasting, 900, 21));
    CHECK(accel(lasting, 900, 0) != accel(InertialOptions{}.without_errors(), 900, 0));
    InertialOptions biased = InertialOptions{}.without_errors();
    biased.accel_bias = InertialOptions{}.accel_bias;
    CHECK((accel(biased, 900, 0) - accel(biased, 900, 21)).norm() > 0.1 * biased.accel_bias);
    CHECK((accel(biased, 900, 63) - accel(biased, 900, 21)).norm() > 0.1 * biased.accel_bias);
  }

  TEST_CASE("at rest the unit feels gravity and nothing else") {
    const Drive drive = small_drive(4);
    const auto perfect = record_imu(drive, InertialOptions{}.without_errors(), Timestamp(), Rng(1));
    CHECK(perfect.front().accel.norm() == doctest::Approx(gravity).epsilon(1e-9));
    CHECK(perfect.front().gyro.norm() < 1e-9);
    CHECK(perfect.front().accel.z() > 9.5);
    CHECK(perfect[1].time - perfect[0].time == std::chrono::milliseconds(10));
  }

  TEST_CASE("readings saturate at the stated range, and gyroscopes feel the pull of gravity if asked to") {
    const Drive drive = small_drive(5);
    InertialOptions options = InertialOptions().without_errors();
    const auto free = record_imu(drive, options, Timestamp(), Rng(1));
    options.gyro_range = 0.1;
    options.accel_range = 9.8;
    bool reached = false;
    const auto cut = record_imu(drive, options, Timestamp(), Rng(1));
    for (std::size_t i = 0; i < free.size(); ++i) {
      CHECK(cut[i].gyro.cwiseAbs().maxCoeff() <= 0.1);
      CHECK(cut[i].accel == free[i].accel.cwiseMin(9.8).cwiseMax(-9.8));
      reached = reached || cut[i].gyro != free[i].gyro;
    }
    CHECK(reached);

    InertialOptions sensitive = InertialOptions().without_errors();
    sensitive.g_sensitivity = 1e-3;
    const auto pulled = record_imu(drive, sensitive, Timestamp(), Rng(1));
    const Eigen::Vector3d at_rest = pulled[10].gyro - free[10].gyro;
    CHECK(at_rest.norm() > 1e-3);  // 9.81 times a number of size 1e-3 on each axis
    CHECK(at_rest.norm() < 5e-2);
  }
}

}  // namespace chainslam::simulator
