#include "chainslam/odometry/imu_alignment.hpp"

#include <doctest/doctest.h>

#include <Eigen/Core>
#include <cmath>

#include "chainslam/core/random.hpp"
#include "support/property.hpp"

using namespace chainslam;

namespace {

Eigen::Vector3d any_vector(Rng& rng) { return {rng.normal(), rng.normal(), rng.normal()}; }
ImuCorrection any_correction(Rng& rng) { return {rng.normal(0, 0.1), SO3d::exp(any_vector(rng))}; }
ImuSample any_sample(Rng& rng) {
  return {.time = Timestamp::from_seconds(1000 + rng.uniform(0, 100)),
          .gyro = any_vector(rng),
          .accel = any_vector(rng),
          .rate_measured = rng.uniform() < 0.5,
          .force_measured = rng.uniform() < 0.5};
}
void check_equal(const ImuSample& a, const ImuSample& b) {
  CHECK(std::abs(to_seconds(a.time - b.time)) <= 2e-9);  // each correction rounds to a nanosecond
  CHECK((a.gyro - b.gyro).norm() < 1e-12);
  CHECK((a.accel - b.accel).norm() < 1e-12);
  CHECK(a.rate_measured == b.rate_measured);
  CHECK(a.force_measured == b.force_measured);
}

}  // namespace

TEST_SUITE("sensor/imu_correction") {
  TEST_CASE("a clock 70 ms late and axes turned by 90 degrees about z, by hand") {
    const ImuCorrection correction{0.07, SO3d::exp({0, 0, std::acos(0.0)})};
    const ImuSample sample = correction({.time = Timestamp::from_seconds(5.07), .gyro = {1, 2, 3}, .accel = {4, 5, 6}});
    CHECK(sample.time == Timestamp::from_seconds(5));
    CHECK((sample.gyro - Eigen::Vector3d(-2, 1, 3)).norm() < 1e-12);
    CHECK((sample.accel - Eigen::Vector3d(-5, 4, 6)).norm() < 1e-12);
  }

  TEST_CASE("no correction leaves a sample as it is") {
    test::for_all(20, [](Rng& rng, int) {
      const ImuSample sample = any_sample(rng), same = ImuCorrection{}(sample);
      CHECK(same.time == sample.time);
      CHECK(same.gyro == sample.gyro);
      CHECK(same.accel == sample.accel);
    });
  }

  TEST_CASE("b.since(a) after a is b, whatever a and b") {
    test::for_all(100, [](Rng& rng, int) {
      const ImuCorrection a = any_correction(rng), b = any_correction(rng);
      const ImuSample sample = any_sample(rng);
      check_equal(b.since(a)(a(sample)), b(sample));
      check_equal(a.since(a)(sample), sample);
      check_equal(a.since({})(sample), a(sample));
    });
  }
}
