#include "chainslam/odometry/imu_process.hpp"

#include <doctest/doctest.h>

#include <vector>

#include "chainslam/core/random.hpp"
#include "odometry/imu_samples.hpp"

using namespace chainslam;
using chainslam::test::sample_at;

TEST_SUITE("odometry/imu_initializer") {
  TEST_CASE("a standstill tells gravity's direction and the bias, in any unit of acceleration") {
    for (const double unit : {1.0, 9.81}) {
      Rng rng(3);
      const Eigen::Vector3d up = Eigen::Vector3d(0.2, -0.1, -0.95).normalized();
      const Eigen::Vector3d bias(0.01, -0.02, 0.005);
      std::vector<ImuSample> samples;
      for (int i = 0; i < 200; ++i)
        samples.push_back(sample_at(0.01 * i, bias + 0.002 * Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()),
                                    unit * (up + 0.005 * Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal()))));
      const ImuStart start = ImuInitializer{}.estimate(samples);
      CHECK(start.at_rest);
      CHECK((start.gyro_bias - bias).norm() < 1e-3);
      CHECK((start.up_body - up).norm() < 2e-3);
      CHECK((gravity_aligned(start.up_body) * start.up_body - Eigen::Vector3d::UnitZ()).norm() < 1e-12);
    }
  }

  TEST_CASE("motion is no standstill: no bias, but up is still told from down") {
    Rng rng(4);
    std::vector<ImuSample> shaken, turning;
    for (int i = 0; i < 200; ++i) {
      shaken.push_back(sample_at(0.01 * i, {rng.normal(0, 0.3), rng.normal(0, 0.3), rng.normal(0, 0.3)},
                                 {rng.normal(0, 2), rng.normal(0, 2), 9.81 + rng.normal(0, 2)}));
      turning.push_back(sample_at(0.01 * i, {0, 0, 0.5}));
    }
    for (const auto& samples : {shaken, turning}) {
      const ImuStart start = ImuInitializer{}.estimate(samples);
      CHECK_FALSE(start.at_rest);
      CHECK(start.gyro_bias.norm() == 0);
      CHECK(start.up_body.z() > 0.95);
    }
  }

  TEST_CASE("too few samples say nothing, gravity upside down is turned over") {
    CHECK_FALSE(ImuInitializer{}.estimate(std::vector<ImuSample>{}).at_rest);
    CHECK(ImuInitializer{}.estimate(std::vector<ImuSample>(4, sample_at(0, {0, 0, 0}))).up_body.z() == 1);
    const Eigen::Vector3d down = -Eigen::Vector3d::UnitZ();
    CHECK((gravity_aligned(down) * down - Eigen::Vector3d::UnitZ()).norm() < 1e-12);
  }

  TEST_CASE("samples with a stuck axis do not count") {
    std::vector<ImuSample> samples;
    for (int i = 0; i < 20; ++i) samples.push_back(sample_at(0.01 * i, {1, 0, 0.002}, {0, 9.81, 0}));
    for (std::size_t i = 0; i < 10; ++i) {
      samples[i].gyro = {0.001, 0, 0.002};
      samples[i].accel = {0, 0, 9.81};
    }
    for (std::size_t i = 10; i < 20; ++i) (i % 2 == 0 ? samples[i].rate_measured : samples[i].force_measured) = false;
    const ImuStart start = ImuInitializer{}.estimate(samples);
    CHECK(start.samples == 10);
    CHECK(start.at_rest);
    CHECK(start.up_body == Eigen::Vector3d::UnitZ());
    CHECK(start.gyro_bias.isApprox(Eigen::Vector3d(0.001, 0, 0.002)));
  }
}
