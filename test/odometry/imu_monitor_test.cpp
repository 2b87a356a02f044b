#include "chainslam/odometry/detail/imu_monitor.hpp"

#include <doctest/doctest.h>

#include <Eigen/Core>
#include <cmath>
#include <limits>

#include "chainslam/core/random.hpp"

using namespace chainslam;

namespace {

constexpr double scan_interval = 0.1;  // seconds between scans
const Eigen::Vector3d gravity(0, 0, 9.81);

/// A sensor without errors.
detail::ImuComparison agreement() { return {.interval = scan_interval, .up = gravity, .expected_up = gravity}; }
detail::ImuComparison rate_error(double error) {
  detail::ImuComparison comparison = agreement();
  comparison.rate_error = {0, 0, error};
  return comparison;
}
detail::ImuComparison accel_error(double error) {
  detail::ImuComparison comparison = agreement();
  comparison.up.x() += error;
  return comparison;
}

/// Scans until the monitor says so, at most `most`.
template <class Comparison>
int scans_until(detail::ImuMonitor& monitor, ImuUse wanted, Comparison&& comparison, int most = 2000) {
  for (int i = 0; i < most; ++i) {
    if (monitor.use() == wanted) return i;
    monitor.follow(monitor.use(), comparison(i));
  }
  return most;
}
template <class Comparison>
void follow(detail::ImuMonitor& monitor, double seconds, Comparison&& comparison) {
  for (int i = 0; i < std::lround(seconds / scan_interval); ++i) monitor.follow(monitor.use(), comparison(i));
}
const auto good = [](int) { return agreement(); };

/// Whether all is still believed after a minute in which every `period`-th scan could only be predicted with `used`.
bool believed_with_contradictions(ImuUse used, int period) {
  detail::ImuMonitor monitor;
  for (int i = 0; i < 600; ++i) monitor.follow(i % period == 0 ? used : ImuUse::all, agreement());
  return monitor.use() == ImuUse::all;
}

/// Contradicts the accelerometer until it is doubted. @returns the scans that took.
int contradict(detail::ImuMonitor& monitor, ImuUse used) {
  int scans = 0;
  while (monitor.use() == ImuUse::all && scans < 100) {
    monitor.follow(used, agreement());
    ++scans;
  }
  return scans;
}

}  // namespace

TEST_SUITE("odometry/imu_monitor") {
  TEST_CASE("a sensor that contradicts every second scan is not believed, one that does so every third is") {
    for (const ImuUse used : {ImuUse::gyroscope, ImuUse::rough_gyroscope, ImuUse::none}) {
      CHECK_FALSE(believed_with_contradictions(used, 1));
      CHECK_FALSE(believed_with_contradictions(used, 2));
      CHECK(believed_with_contradictions(used, 3));
    }
  }

  TEST_CASE("three contradictions in a row are forgiven, the fourth is not; only the sensor concerned is doubted") {
    detail::ImuMonitor accelerometer, gyroscope;
    CHECK(contradict(accelerometer, ImuUse::gyroscope) == 4);
    CHECK(accelerometer.use() == ImuUse::gyroscope);
    CHECK(contradict(gyroscope, ImuUse::rough_gyroscope) == 4);
    CHECK(gyroscope.use() == ImuUse::none);
  }

  TEST_CASE("a pothole is forgiven: half a second's mean of 0.5 m/s^2, and 5 m/s^2 for one scan") {
    detail::ImuMonitor monitor;
    follow(monitor, 10, good);
    monitor.follow(ImuUse::gyroscope, accel_error(5));
    CHECK(monitor.use() == ImuUse::all);
    CHECK(monitor.accel_error().x() == doctest::Approx(0.5));
    follow(monitor, 10, good);
    for (int i = 0; i < 5; ++i) monitor.follow(ImuUse::all, accel_error(i % 2 == 0 ? 1.5 : -1));
    CHECK(monitor.use() == ImuUse::all);
  }

  TEST_CASE("errors within an IMU's biases are believed for ever, larger ones are not for a second") {
    // Biases of MEMS gyroscopes when switched on reach 1 deg/s, those of their accelerometers 0.05 g.
    detail::ImuMonitor biased;
    follow(biased, 100, [](int) {
      detail::ImuComparison comparison = rate_error(0.0175);
      comparison.up.x() += 0.49;
      return comparison;
    });
    CHECK(biased.use() == ImuUse::all);
    // Axes that are 3 degrees off, in a turn of 45 deg/s; a mean force that is off by 0.15 g.
    detail::ImuMonitor turned, forced;
    CHECK(scans_until(turned, ImuUse::none, [](int) { return rate_error(0.041); }) <= 15);
    CHECK(scans_until(forced, ImuUse::gyroscope, [](int) { return accel_error(1.5); }) <= 15);
    // An axis that is stuck, or units of degrees: noticed at once.
    detail::ImuMonitor stuck;
    CHECK(scans_until(stuck, ImuUse::none, [](int) { return rate_error(0.5); }) <= 1);
  }

  TEST_CASE("the noise of a vibrating mount averages out") {
    Rng rng(7);
    detail::ImuMonitor monitor;
    follow(monitor, 600, [&](int) {
      detail::ImuComparison comparison = agreement();
      for (int axis = 0; axis < 3; ++axis) {
        comparison.rate_error[axis] = rng.normal(0, 0.02);
        comparison.up[axis] += rng.normal(0, 0.4);
      }
      return comparison;
    });
    CHECK(monitor.use() == ImuUse::all);
  }

  TEST_CASE("a sensor is believed again after three seconds of agreement, then six, up to a minute, no more") {
    for (const ImuUse used : {ImuUse::gyroscope, ImuUse::none}) {
      detail::ImuMonitor monitor;
      for (const double trial : {3, 6, 12, 24, 48, 60, 60}) {
        contradict(monitor, used);
        const double waited = scan_interval * scans_until(monitor, ImuUse::all, good);
        CHECK(waited >= trial - 1e-6);
        CHECK(waited <= trial + 0.5);
      }
    }
  }

  TEST_CASE("a contradiction during the trial starts it anew, a doubted accelerometer's contradictions do not count") {
    detail::ImuMonitor monitor;
    contradict(monitor, ImuUse::gyroscope);
    follow(monitor, 2.8, good);
    monitor.follow(ImuUse::gyroscope, rate_error(0.5));  // no: what is not believed cannot contradict
    CHECK(monitor.use() == ImuUse::none);                // the gyroscope, by its error
    follow(monitor, 2.5, good);
    CHECK(monitor.use() != ImuUse::all);
    CHECK(scans_until(monitor, ImuUse::all, good) <= 60);
  }

  TEST_CASE("an error that goes on keeps a sensor doubted") {
    detail::ImuMonitor monitor;
    CHECK(scans_until(monitor, ImuUse::none, [](int) { return rate_error(0.1); }) < 10);
    follow(monitor, 300, [](int) { return rate_error(0.1); });
    CHECK(monitor.use() == ImuUse::none);
    CHECK(scan_interval * scans_until(monitor, ImuUse::all, good) < 6);
  }

  TEST_CASE("while the accelerometer is not believed, gravity's direction is found from it all the same") {
    // Learnt wrongly by 0.2 rad, which is why the accelerometer was doubted; its own noise is 0.3 m/s^2.
    Rng rng(8);
    const Eigen::Vector3d learnt(9.81 * std::sin(0.2), 0, 9.81 * std::cos(0.2));
    detail::ImuMonitor monitor;
    double back_after = -1;
    for (int i = 0; i < 200 && back_after < 0; ++i) {
      detail::ImuComparison comparison{.interval = scan_interval, .up = gravity, .expected_up = learnt};
      for (int axis = 0; axis < 3; ++axis) comparison.up[axis] += rng.normal(0, 0.3);
      monitor.follow(monitor.use(), comparison);
      if (i == 10) CHECK(monitor.use() == ImuUse::gyroscope);
      if (monitor.back_to_all()) back_after = scan_interval * i;
    }
    CHECK(back_after > 3);
    CHECK(back_after < 8);
    const double angle = std::acos(std::min(1.0, monitor.up().direction().z()));
    CHECK(angle < 0.02);  // 0.3 / 9.81 / sqrt(50) are 0.004
    monitor.follow(monitor.use(), agreement());
    CHECK_FALSE(monitor.back_to_all());  // said once
  }

  TEST_CASE("gravity's direction follows a map that turns by a degree in half a minute") {
    detail::ImuMonitor monitor;
    double angle = 0;
    follow(monitor, 60, [&](int i) {
      angle = 0.0175 * i * scan_interval / 30;
      detail::ImuComparison comparison = agreement();
      comparison.up = 9.81 * Eigen::Vector3d(std::sin(angle), 0, std::cos(angle));
      return comparison;
    });
    const double found = std::asin(monitor.up().direction().x());
    CHECK(std::abs(found - angle) < 0.0035);
  }

  TEST_CASE("without a measured force nothing is said of the accelerometer") {
    detail::ImuMonitor monitor;
    follow(monitor, 10, [](int) {
      detail::ImuComparison comparison = accel_error(50);
      comparison.force_measured = false;
      return comparison;
    });
    CHECK(monitor.use() == ImuUse::all);
    CHECK(monitor.accel_error().norm() == 0);
  }

  TEST_CASE("an interval without measurements, length 0, changes nothing") {
    detail::ImuMonitor monitor;
    follow(monitor, 10, [](int) { return detail::ImuComparison{.interval = 0, .rate_error = {9, 9, 9}}; });
    CHECK(monitor.use() == ImuUse::all);
    CHECK(monitor.rate_error().norm() == 0);
  }

  TEST_CASE("with an infinite limit all is believed, whatever comes") {
    detail::ImuMonitor monitor({.max_pose_nis = std::numeric_limits<double>::infinity()});
    CHECK_FALSE(monitor.enabled());
    for (int i = 0; i < 100; ++i) monitor.follow(ImuUse::none, rate_error(9));
    CHECK(monitor.use() == ImuUse::all);
  }
}
