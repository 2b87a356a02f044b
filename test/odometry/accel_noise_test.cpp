#include "chainslam/odometry/detail/accel_noise.hpp"

#include <doctest/doctest.h>

#include <Eigen/Core>
#include <cmath>

#include "chainslam/core/random.hpp"

using namespace chainslam;

namespace {

/// A body that accelerates along x as it likes, and what is measured of it.
struct NoisyForces {
  double density = 0;             ///< of white noise of the accelerometer, m/s^2 per sqrt(Hz)
  double registration = 0;        ///< deviation of the scans' positions, metres
  Eigen::Vector3d bias{0, 0, 0};  ///< of the specific force, m/s^2
  double scan_interval = 0.1;     ///< seconds
  Rng rng{5};
  double time = 0;
  Eigen::Vector3d position{0, 0, 0}, velocity{0, 0, 0};

  [[nodiscard]] Eigen::Vector3d noise(double deviation) {
    return {rng.normal(0, deviation), rng.normal(0, deviation), rng.normal(0, deviation)};
  }

  /// Goes on to the next scan.
  void follow(detail::AccelNoise& learned) {
    constexpr int steps = 10;
    const double dt = scan_interval / steps;
    Eigen::Vector3d gain(0, 0, 0), way(0, 0, 0);
    for (int i = 0; i < steps; ++i, time += dt) {
      const Eigen::Vector3d acceleration(2 * std::sin(0.7 * time), std::cos(1.3 * time), 0);
      position += dt * velocity + 0.5 * dt * dt * acceleration;
      velocity += dt * acceleration;
      const Eigen::Vector3d force = acceleration + Eigen::Vector3d(0, 0, 9.81) + bias + noise(density / std::sqrt(dt));
      way += dt * gain + 0.5 * dt * dt * force;
      gain += dt * force;
    }
    const Eigen::Vector3d force = gain / scan_interval;
    learned.follow({.interval = scan_interval, .force = force, .force_way = way, .up = {0, 0, 9.81}},
                   position + noise(registration));
  }
};

double learned_in(double seconds, NoisyForces forces, const AccelNoiseOptions& options = {}) {
  detail::AccelNoise noise(options);
  for (int i = 0; i < std::lround(seconds / forces.scan_interval); ++i) forces.follow(noise);
  return noise.density();
}

}  // namespace

TEST_SUITE("odometry/accel_noise") {
  TEST_CASE("the density of white noise is found, whatever the rate of the scans") {
    for (const double interval : {0.05, 0.1, 0.5, 0.9})
      for (const double density : {0.05, 0.2}) {
        CAPTURE(interval);
        CAPTURE(density);
        const double learned = learned_in(600, {.density = density, .scan_interval = interval}, {.memory = 300});
        CHECK(std::abs(learned / density - 1) < 0.15);
      }
  }

  TEST_CASE("a bias and gravity that is not what it was taken for are no noise") {
    CHECK(learned_in(300, {.bias = {0.3, -0.2, 0.1}}) < 1e-3);
  }

  TEST_CASE("registration to 3 mm hardly counts") { CHECK(learned_in(120, {.registration = 0.003}) < 0.03); }

  // Gravity is learnt in a drive's first seconds: by an accelerometer as good as usual until it is known to be worse.
  // Taking it for five times as noisy at first cost 0.05 m of a minute through the simulated town.
  TEST_CASE("noise is small until it is known, and known in the first seconds") {
    CHECK(detail::AccelNoise().density() == doctest::Approx(0.02).scale(0));
    CHECK(learned_in(1.9, {.density = 0.3}) == doctest::Approx(0.02).scale(0));
    CHECK(learned_in(4, {.density = 0.3}) > 0.15);
    CHECK(learned_in(10, {.density = 0.3}) > 0.2);
    CHECK(learned_in(10, {.density = 0.01}) < 0.02);
  }

  TEST_CASE("noise that comes or ceases is followed within half a minute") {
    detail::AccelNoise noise;
    NoisyForces forces{.density = 0.02};
    for (int i = 0; i < 600; ++i) forces.follow(noise);
    CHECK(noise.density() < 0.03);
    forces.density = 0.3;
    for (int i = 0; i < 300; ++i) forces.follow(noise);
    CHECK(noise.density() > 0.18);
    forces.density = 0.02;
    for (int i = 0; i < 900; ++i) forces.follow(noise);
    CHECK(noise.density() < 0.06);
  }

  TEST_CASE("positions and forces on both sides of an interruption are not compared") {
    detail::AccelNoise noise;
    NoisyForces forces{.density = 0.02};
    for (int i = 0; i < 600; ++i) forces.follow(noise);
    const double before = noise.density();
    forces.position.x() += 50;
    noise.interrupt();
    for (int i = 0; i < 15; ++i) forces.follow(noise);
    CHECK(noise.density() == doctest::Approx(before).scale(0).epsilon(1e-12));
    noise.follow({}, forces.position);  // not all of it was measured: the same
    for (int i = 0; i < 15; ++i) forces.follow(noise);
    CHECK(noise.density() == doctest::Approx(before).scale(0).epsilon(1e-12));
    noise.restart();
    CHECK(noise.density() == doctest::Approx(AccelNoiseOptions{}.start).scale(0));
  }

  TEST_CASE("one scan that is registered to a wrong place does not make an accelerometer unusable") {
    detail::AccelNoise noise;
    NoisyForces forces{.density = 0.02};
    for (int i = 0; i < 600; ++i) forces.follow(noise);
    forces.position.x() += 20;
    for (int i = 0; i < 50; ++i) forces.follow(noise);
    CHECK(noise.density() < 0.6);
  }

  TEST_CASE("it can be left to the noise that is given") { CHECK(learned_in(60, {.density = 0.3}, {.start = 0}) == 0); }
}
