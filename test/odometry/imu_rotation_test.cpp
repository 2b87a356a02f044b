#include "chainslam/odometry/detail/imu_rotation.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <limits>

#include "odometry/imu_samples.hpp"
#include "support/property.hpp"

using namespace chainslam;
using chainslam::test::angle_between;
using chainslam::test::at;
using chainslam::test::for_all;
using chainslam::test::sample_at;

namespace {

/// A rate that turns its own axis: the integral has no closed form and coning matters.
Eigen::Vector3d coning_rate(double t) {
  return {0.8 * std::sin(6 * t), 0.8 * std::cos(6 * t), 0.3 + 0.2 * std::sin(2 * t)};
}

SO3d integrated_finely(double from, double to) {
  SO3d R;
  const int steps = 20000;
  const double h = (to - from) / steps;
  for (int i = 0; i < steps; ++i) R = R * SO3d::exp(h * coning_rate(from + (i + 0.5) * h));
  return R;
}

}  // namespace

TEST_SUITE("odometry/imu_rotation") {
  TEST_CASE("a constant rate less the bias turns by rate times time, between samples too") {
    for_all(20, [](Rng& rng, int) {
      const Eigen::Vector3d rate(rng.uniform(-2, 2), rng.uniform(-2, 2), rng.uniform(-2, 2));
      const Eigen::Vector3d bias(0.02, -0.01, 0.03);
      detail::ImuRotation imu;
      for (int i = 0; i <= 50; ++i) CHECK(imu.add(sample_at(0.01 * i, rate + bias)));
      const double from = rng.uniform(0, 0.2), to = rng.uniform(0.25, 0.5);
      const auto R = imu.rotation(at(from), at(to), bias);
      REQUIRE(R.has_value());
      CHECK(angle_between(*R, SO3d::exp((to - from) * rate)) < 1e-8);  // times are whole nanoseconds
    });
  }

  TEST_CASE("a coning motion is followed to fourth order in the sampling interval") {
    const auto error = [](int samples_per_second) {
      detail::ImuRotation imu;
      for (int i = 0; i <= samples_per_second; ++i) {
        const double t = static_cast<double>(i) / samples_per_second;
        imu.add(sample_at(t, coning_rate(t)));
      }
      return angle_between(*imu.rotation(at(0), at(1), Eigen::Vector3d::Zero()), integrated_finely(0, 1));
    };
    CHECK(error(100) < 2e-4);
    // Linear rates between samples leave an error of second order, a quarter for twice the samples; without the coning
    // term it would be 2.4 times as large at 20 Hz.
    CHECK(error(20) < 0.005);
    CHECK(error(40) < 0.3 * error(20));
  }

  TEST_CASE("rotations join: from a to c is from a to b and from b to c") {
    detail::ImuRotation imu;
    for (int i = 0; i <= 100; ++i) imu.add(sample_at(0.01 * i, coning_rate(0.01 * i)));
    const Eigen::Vector3d none = Eigen::Vector3d::Zero();
    const SO3d whole = *imu.rotation(at(0.1), at(0.9), none);
    const SO3d joined = *imu.rotation(at(0.1), at(0.5), none) * *imu.rotation(at(0.5), at(0.9), none);
    CHECK(angle_between(whole, joined) < 1e-12);
  }

  TEST_CASE("holes: short ones are bridged, long ones have no answer") {
    const Eigen::Vector3d rate(0, 0, 1), none = Eigen::Vector3d::Zero();
    detail::ImuRotation imu(seconds(0.25));
    CHECK_FALSE(imu.rotation(at(0), at(0.1), none).has_value());
    for (const double t : {0.0, 0.1, 0.3, 0.4}) imu.add(sample_at(t, rate));
    for (const double t : {1.0, 1.1}) imu.add(sample_at(t, rate));
    CHECK(angle_between(*imu.rotation(at(0), at(0.4), none), SO3d::exp({0, 0, 0.4})) < 1e-9);
    CHECK(imu.rotation(at(-0.2), at(0.4), none).has_value());
    CHECK_FALSE(imu.rotation(at(-0.3), at(0.4), none).has_value());
    CHECK_FALSE(imu.rotation(at(0.3), at(1.05), none).has_value());
    CHECK_FALSE(imu.rotation(at(0.5), at(0.8), none).has_value());
    CHECK(imu.rotation(at(1.0), at(1.3), none).has_value());
    CHECK_FALSE(imu.rotation(at(1.0), at(1.4), none).has_value());
    CHECK_FALSE(imu.rotation(at(1.1), at(1.0), none).has_value());
  }

  TEST_CASE("broken samples are dropped; a clock set back starts the record anew") {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    detail::ImuRotation imu(seconds(0.25));
    CHECK(imu.add(sample_at(10, {0, 0, 1})));
    CHECK_FALSE(imu.add(sample_at(10, {0, 0, 1})));
    CHECK_FALSE(imu.add(sample_at(9.9, {0, 0, 1})));
    CHECK_FALSE(imu.add(sample_at(10.1, {0, nan, 1})));
    CHECK_FALSE(imu.add(sample_at(10.1, {0, 0, 1}, {0, 0, nan})));
    CHECK(imu.samples().size() == 1);
    CHECK(imu.add(sample_at(3, {0, 0, 1})));
    CHECK(imu.samples().size() == 1);
    CHECK(imu.add(sample_at(3.1, {0, 0, 1})));
    imu.forget_before(at(3.1));
    CHECK(imu.samples().size() == 1);
  }
}
