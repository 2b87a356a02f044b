#include "chainslam/sensor/imu_units.hpp"

#include <doctest/doctest.h>

#include <Eigen/Geometry>
#include <fstream>
#include <limits>

#include "support/real_data.hpp"

using namespace chainslam;

namespace {

/// Ten seconds at 100 Hz of a body that rocks about x and turns about z; or only turns if `tilt` is zero.
std::vector<ImuSample> rocking(double tilt, double accel_scale, double gyro_scale) {
  std::vector<ImuSample> samples;
  for (int i = 0; i < 1000; ++i) {
    const double t = 0.01 * i, roll = tilt * std::sin(2 * t), rate = 2 * tilt * std::cos(2 * t), yaw_rate = 0.3;
    const Eigen::AngleAxisd R_rolled_body(roll, Eigen::Vector3d::UnitX());
    const Eigen::Vector3d gyro =
        Eigen::Vector3d(rate, 0, 0) + R_rolled_body.inverse() * Eigen::Vector3d(0, 0, yaw_rate);
    const Eigen::Vector3d accel = R_rolled_body.inverse() * Eigen::Vector3d(0, 0, 9.80665);
    samples.push_back({Timestamp::from_seconds(t), gyro * gyro_scale, accel * accel_scale});
  }
  return samples;
}

constexpr double degree = 3.14159265358979323846 / 180;

}  // namespace

TEST_SUITE("sensor/imu_units") {
  TEST_CASE("a rocking body tells all four combinations of units") {
    for (const bool in_g : {false, true})
      for (const bool in_degrees : {false, true}) {
        const auto units = infer_imu_units(rocking(0.2, in_g ? 1 / 9.80665 : 1, in_degrees ? 1 / degree : 1));
        CAPTURE(units.sentence);
        CHECK(units.accel == (in_g ? AccelUnit::g : AccelUnit::metres_per_second_squared));
        CHECK(units.gyro == (in_degrees ? GyroUnit::degrees_per_second : GyroUnit::radians_per_second));
        CHECK(units.gravity_scale == doctest::Approx(in_degrees ? degree : 1).epsilon(0.1));
        CHECK(units.accel_scale() * units.median_accel == doctest::Approx(9.80665));
      }
  }

  TEST_CASE("turning about the vertical leaves the gyroscope's unit unknown, and the scale at one") {
    const auto units = infer_imu_units(rocking(0, 1, 1));
    CHECK(units.accel == AccelUnit::metres_per_second_squared);
    CHECK(units.gyro == GyroUnit::unknown);
    CHECK(units.gyro_scale() == 1);
    CHECK(units.sentence.find("unknown") != std::string::npos);
  }

  TEST_CASE("rates that no gyroscope gives in rad/s are degrees") {
    auto samples = rocking(0, 1, 1);
    for (ImuSample& sample : samples) sample.gyro *= 200;
    CHECK(infer_imu_units(samples).gyro == GyroUnit::degrees_per_second);
  }

  TEST_CASE("no samples, one sample and numbers that are not finite leave everything unknown") {
    CHECK(infer_imu_units({}).accel == AccelUnit::unknown);
    auto samples = rocking(0.2, 1, 1);
    CHECK(infer_imu_units(std::span(samples).first(1)).gyro == GyroUnit::unknown);
    for (ImuSample& sample : samples) sample.accel.x() = std::numeric_limits<double>::quiet_NaN();
    const auto units = infer_imu_units(samples);
    CHECK(units.used == 0);
    CHECK(units.accel == AccelUnit::unknown);
    CHECK(units.gyro == GyroUnit::unknown);
  }

  TEST_CASE("a real hand-held recording is recognized, in its own units and in others") {
    const auto file = test::real_data("imu/gtsam_points_continuous/imu.txt");
    if (!file) return;
    std::ifstream in(*file);
    std::vector<ImuSample> samples;
    double t = 0;
    Eigen::Vector3d a, w;
    while (in >> t >> a.x() >> a.y() >> a.z() >> w.x() >> w.y() >> w.z())
      samples.push_back({Timestamp::from_seconds(t), w, a});
    REQUIRE(samples.size() == 23739);
    const auto units = infer_imu_units(samples);
    CAPTURE(units.sentence);
    CHECK(units.accel == AccelUnit::metres_per_second_squared);
    CHECK(units.gyro == GyroUnit::radians_per_second);
    for (ImuSample& sample : samples) {
      sample.accel /= 9.80665;
      sample.gyro /= degree;
    }
    const auto changed = infer_imu_units(samples);
    CHECK(changed.accel == AccelUnit::g);
    CHECK(changed.gyro == GyroUnit::degrees_per_second);
  }
}
