#include "support/imu_clock.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <optional>
#include <vector>

using namespace chainslam;
using support::ImuCalibration;
using support::ImuClock;

namespace {

Timestamp at(double time) { return Timestamp::from_seconds(1e9) + seconds(time); }

/// IMU stamps are late by `late` seconds, of which `given` was known beforehand.
ImuCalibration calibration(double late, bool known, double given = 0) {
  ImuCalibration result;
  result.time_offset = -given;
  result.applied.time_offset = late - given;
  result.found.time_offset = result.applied.time_offset;
  result.found.time_known = known;
  return result;
}

}  // namespace

TEST_SUITE("support/imu_clock") {
  TEST_CASE("frames that wait are shifted once, when the offset is known, and those that come then as well") {
    ImuClock clock(true);
    for (int k = 0; k < 300; ++k) {
      const double now = 0.1 * k;
      const std::optional<double> shift = clock.follow(at(now), calibration(k < 200 ? 0.0 : 0.3, k >= 200));
      CHECK(shift.has_value() == (k == 200));
      if (shift) CHECK(*shift == doctest::Approx(0.3));
      CHECK(std::abs(to_seconds(clock.frame_time() - at(now)) - (k < 200 ? 0 : 0.3)) < 1e-6);
    }
    CHECK_FALSE(clock.end());
  }

  TEST_CASE("an offset that is known and not yet applied counts, unless it was fitted to wrong axes") {
    ImuCalibration found = calibration(0, true);
    found.found.time_offset = 0.015;
    CHECK(ImuClock(true).follow(at(0), found).value() == doctest::Approx(0.015));
    found.found.time_offset = 0.2;
    found.found.contradicted = true;
    ImuClock clock(true);
    CHECK_FALSE(clock.follow(at(0), found));
    CHECK_FALSE(clock.follow(at(1), found));
    CHECK(clock.follow(at(2), calibration(0.2, true)).value() == doctest::Approx(0.2));
    found.found.time_offset = 0.008;  // as odometry leaves it
    CHECK(ImuClock(true).follow(at(0), found).value() == 0);
  }

  TEST_CASE("what was given counts, also if the data end before they show more") {
    ImuClock clock(true);
    CHECK_FALSE(clock.follow(at(0), calibration(0.04, false, 0.04)));
    CHECK_FALSE(clock.follow(at(1), calibration(0.04, false, 0.04)));
    CHECK(clock.end().value() == doctest::Approx(0.04));
    ImuClock at_once(false);
    CHECK_FALSE(at_once.follow(at(0), calibration(0.04, false, 0.04)));
    CHECK(std::abs(to_seconds(at_once.frame_time() - at(0)) - 0.04) < 1e-6);
  }

  TEST_CASE("nobody waits longer than five minutes, or five seconds without an IMU") {
    ImuClock clock(true);
    CHECK_FALSE(clock.follow(at(0), calibration(0.02, false)));
    CHECK_FALSE(clock.follow(at(299.9), calibration(0.02, false)));
    CHECK(clock.follow(at(300.1), calibration(0.02, false)).value() == doctest::Approx(0.02));
    ImuClock without(true);
    CHECK_FALSE(without.follow(at(0), std::nullopt));
    CHECK(without.follow(at(5.1), std::nullopt).value() == 0);
    CHECK(without.frame_time() == at(5.1));
    ImuClock later(true);
    CHECK_FALSE(later.follow(at(0), std::nullopt));
    CHECK_FALSE(later.follow(at(0.1), calibration(0, false)));
    CHECK(later.follow(at(20), calibration(0.2, true)).value() == doctest::Approx(0.2));
    ImuClock given(true, -0.03);
    CHECK_FALSE(given.follow(at(0), std::nullopt));
    CHECK(given.end().value() == 0.03);
    CHECK(std::abs(to_seconds(given.frame_time() - at(0)) - 0.03) < 1e-6);
  }

  TEST_CASE("times ascend while a correction comes that is longer than a scan") {
    ImuClock clock(false);
    std::vector<Timestamp> times;
    for (int k = 0; k < 60; ++k) {
      const double late = k < 20 ? 0 : k < 40 ? 0.25 : -0.25;
      CHECK_FALSE(clock.follow(at(0.1 * k), calibration(late, true)));
      if (!times.empty()) CHECK(clock.frame_time() > times.back());
      times.push_back(clock.frame_time());
    }
    CHECK(std::abs(to_seconds(times[39] - at(3.9)) - 0.25) < 1e-6);
    CHECK(std::abs(to_seconds(times[59] - at(5.9)) + 0.25) < 1e-6);
  }
}
