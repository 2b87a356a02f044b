#include "simulator/gnss_receiver.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <numbers>

#include "simulator/place.hpp"
#include "simulator/preset.hpp"
#include "simulator/rig.hpp"

namespace chainslam::simulator {
namespace {

Drive small_drive() {
  const Preset options = *preset("town-small");
  return Drive(options.drive, options.sessions[0].route, make_town(options.town, Rng(1)), Rng(1).fork(1));
}

/// Flat, and nothing on it.
const RayCaster& field() {
  static const RayCaster caster(
      [] {
        World world;
        world.ground = {
            .origin = {-500.0F, -500.0F}, .spacing = 1000.0F, .columns = 2, .rows = 2, .heights = {}, .materials = {}};
        world.ground.heights.assign(4, -50.0F);
        world.ground.materials.assign(4, Material::lawn);
        return world;
      }(),
      100.0F);
  return caster;
}

GnssOptions perfect_receiver() {
  return {.least_bias = 0.0, .most_bias = 0.0, .wander = 0.0, .noise = 0.0, .time_between_outages = 1e9};
}

}  // namespace

TEST_SUITE("simulator/gnss_receiver") {
  TEST_CASE("the map frame is north, west, up at NCLT's origin") {
    const Eigen::Vector3d origin = map_to_geodetic(Eigen::Vector3d::Zero());
    CHECK(origin[0] * 180.0 / std::numbers::pi == doctest::Approx(42.293227).epsilon(1e-12));
    CHECK(origin[1] * 180.0 / std::numbers::pi == doctest::Approx(-83.709657).epsilon(1e-12));
    CHECK(origin[2] == doctest::Approx(270.0).epsilon(1e-9));
    CHECK(map_to_geodetic({100.0, 0.0, 0.0})[0] > origin[0]);
    CHECK(map_to_geodetic({0.0, 100.0, 0.0})[1] < origin[1]);
    // NCLT's own formula (radii of curvature in its coordinate_frame.py) agrees to the difference of its ellipsoids.
    const double a = 6378135.0, b = 6356750.0, s = std::sin(origin[0]), c = std::cos(origin[0]);
    const double r_ns = a * a * b * b / std::pow(a * a * c * c + b * b * s * s, 1.5);
    const double r_ew = a * a / std::sqrt(a * a * c * c + b * b * s * s);
    const Eigen::Vector3d there = map_to_geodetic({200.0, -150.0, 3.0});
    CHECK(std::sin(there[0] - origin[0]) * r_ns == doctest::Approx(200.0).epsilon(1e-4));
    CHECK(std::sin(there[1] - origin[1]) * r_ew * c == doctest::Approx(150.0).epsilon(1e-4));
    // Distances survive the way through the Earth's frame.
    CHECK((map_to_ecef({3.0, 4.0, 12.0}) - map_to_ecef(Eigen::Vector3d::Zero())).norm() ==
          doctest::Approx(13.0).epsilon(1e-9));
  }

  TEST_CASE("a perfect receiver gives the antenna's position") {
    const Drive drive = small_drive();
    const auto readings = record_gnss(drive, field(), perfect_receiver(), Timestamp(), Rng(1));
    REQUIRE(readings.size() == static_cast<std::size_t>(drive.duration() * 2.0) + 1);
    for (const GnssReading& reading : readings) {
      const Eigen::Vector3d antenna = drive.pose(reading.time.to_seconds()) * nominal_antenna_body();
      CHECK(reading.mode == 3);
      CHECK((reading.fix.position_ecef - map_to_ecef(antenna)).norm() < 1e-6);
      CHECK(reading.latitude == doctest::Approx(map_to_geodetic(antenna)[0]).epsilon(1e-14));
    }
  }

  TEST_CASE("errors have the stated size, and the covariance says so") {
    const Drive drive = small_drive();
    GnssOptions options;
    options.time_between_outages = 1e9;
    double fast = 0.0;
    double all = 0.0;
    double vertical = 0.0;
    constexpr int sessions = 300;
    for (int session = 0; session < sessions; ++session) {
      const auto readings = record_gnss(drive, field(), options, Timestamp(), Rng(static_cast<std::uint64_t>(session)));
      const auto error = [&](std::size_t i) {
        const Eigen::Vector3d truth = drive.pose(readings[i].time.to_seconds()) * nominal_antenna_body();
        const Eigen::Vector3d zero = map_to_ecef(truth);
        const Eigen::Vector3d error_ecef = readings[i].fix.position_ecef - zero;
        Eigen::Matrix3d R;
        for (int axis = 0; axis < 3; ++axis) R.col(axis) = map_to_ecef(truth + Eigen::Vector3d::Unit(axis)) - zero;
        return Eigen::Vector3d(R.transpose() * error_ecef);
      };
      const Eigen::Vector3d first = error(0);
      const Eigen::Vector3d second = error(1);
      all += first.head<2>().squaredNorm() / 2.0;
      vertical += first.z() * first.z();
      fast += (second - first).head<2>().squaredNorm() / 2.0;
      const double trace = readings[0].fix.covariance_ecef.trace();
      CHECK(trace == doctest::Approx(6.0 * (1.5 * 1.5 + 1.0)).epsilon(1e-6));
    }
    const double wander_step = 2.0 * 1.5 * 1.5 * (1.0 - std::exp(-0.5 / 60.0));
    const double bias_square = (1.0 + 3.0 + 9.0) / 3.0;  // mean of the squares from 1 to 3
    // 600 values: 2.9 % of a standard deviation.
    CHECK(std::sqrt(all / sessions) == doctest::Approx(std::sqrt(0.5 * bias_square + 1.5 * 1.5 + 1.0)).epsilon(0.1));
    CHECK(std::sqrt(vertical / sessions) ==
          doctest::Approx(2.0 * std::sqrt(bias_square / 3.0 + 1.5 * 1.5 + 1.0)).epsilon(0.15));
    CHECK(std::sqrt(fast / sessions) == doctest::Approx(std::sqrt(2.0 + wander_step)).epsilon(0.1));
  }

  TEST_CASE("each session's fixes are off by a constant of its own, 1 to 3 m to the side") {
    const Drive drive = small_drive();
    GnssOptions options = perfect_receiver();
    options.least_bias = 1.0;
    options.most_bias = 3.0;
    double shortest = 3.0;
    double longest = 1.0;
    Eigen::Vector3d previous = Eigen::Vector3d::Zero();
    for (std::uint64_t session = 0; session < 50; ++session) {
      const auto readings = record_gnss(drive, field(), options, Timestamp(), Rng(session));
      const auto perfect = record_gnss(drive, field(), perfect_receiver(), Timestamp(), Rng(session));
      const Eigen::Vector3d bias = readings[0].fix.position_ecef - perfect[0].fix.position_ecef;
      const Eigen::Vector3d up = (map_to_ecef(Eigen::Vector3d::UnitZ()) - map_to_ecef(Eigen::Vector3d::Zero()));
      const double aside = (bias - bias.dot(up) * up).norm();
      shortest = std::min(shortest, aside);
      longest = std::max(longest, aside);
      CHECK((bias - previous).norm() > 0.01);
      previous = bias;
      for (std::size_t i = 0; i < readings.size(); ++i)
        CHECK((readings[i].fix.position_ecef - perfect[i].fix.position_ecef - bias).norm() < 1e-6);
    }
    CHECK(shortest > 0.99);
    CHECK(shortest < 1.3);
    CHECK(longest > 2.7);
    CHECK(longest < 3.01);
  }

  TEST_CASE("outages happen and say so, but not before there were fixes") {
    const Drive drive = small_drive();
    std::size_t lost = 0;
    std::size_t all = 0;
    for (std::uint64_t session = 0; session < 100; ++session)
      for (const GnssReading& reading : record_gnss(drive, field(), {}, Timestamp(), Rng(session))) {
        ++all;
        const bool none = reading.mode == 0;
        CHECK_FALSE((none && reading.time.to_seconds() < 15.0));
        lost += none ? 1 : 0;
        CHECK(none == (reading.fix.quality == GnssQuality::none));
        CHECK(none == std::isnan(reading.altitude));
        CHECK(std::isfinite(reading.latitude));
      }
    // The drive's 28 s see the beginning of an outage in four cases of ten, and most of it.
    CHECK(static_cast<double>(lost) / static_cast<double>(all) > 0.03);
    CHECK(static_cast<double>(lost) / static_cast<double>(all) < 0.09);
  }

  TEST_CASE("a roof takes the sky away, and with it the fixes; walls on both sides take a part of it") {
    World world;
    add_box(world, {}, {-150.0, -150.0, 12.0}, {150.0, 150.0, 13.0}, Material::wall);
    const RayCaster roof(std::move(world));
    const Drive drive = small_drive();
    GnssOptions options = perfect_receiver();
    options.needs_sky = true;
    for (const GnssReading& reading : record_gnss(drive, roof, options, Timestamp(), Rng(1))) CHECK(reading.mode == 0);
    for (const GnssReading& reading : record_gnss(drive, field(), options, Timestamp(), Rng(1)))
      CHECK(reading.mode == 3);

    World canyon;
    for (const double side : {-1.0, 1.0})
      add_box(canyon, {}, {-100.0, side * 12.5 - 2.5, 0.0}, {100.0, side * 12.5 + 2.5, 20.0}, Material::wall);
    const double sky = open_sky(RayCaster(std::move(canyon)), {0.0, 0.0, 1.5});
    CHECK(sky == doctest::Approx(12.0 / 24.0));  // along the street at 20 and 45 degrees, and everything at 75
    CHECK(open_sky(field(), {0.0, 0.0, 1.5}) == 1.0);
  }

  TEST_CASE("bursts of multipath displace fixes for seconds, and some fixes have no altitude") {
    const Drive drive = small_drive();
    GnssOptions options = perfect_receiver();
    options.time_between_bursts = 8.0;
    options.burst_duration = 3.0;
    options.flat_fixes = 0.3;
    int displaced = 0;
    int flat = 0;
    int all = 0;
    for (const std::uint64_t session : {1U, 2U, 3U, 4U, 5U, 6U}) {
      const auto readings = record_gnss(drive, field(), options, Timestamp(), Rng(session));
      bool before = false;
      int changes = 0;
      for (const GnssReading& reading : readings) {
        const Eigen::Vector3d antenna = drive.pose(reading.time.to_seconds()) * nominal_antenna_body();
        const bool off = (reading.fix.position_ecef - map_to_ecef(antenna)).norm() > 0.1;
        displaced += off;
        changes += off != before;
        before = off;
        flat += reading.mode == 2;
        CHECK((reading.mode == 2) == std::isnan(reading.altitude));
        CHECK((reading.mode == 2) == (reading.fix.quality == GnssQuality::two_dimensional));
        ++all;
      }
      CHECK(changes >= 1);
      CHECK(changes <= 9);  // in spells of 1.5 to 4.5 s, not fix by fix
    }
    CHECK(displaced > all / 8);
    CHECK(displaced < all / 2);
    CHECK(flat == doctest::Approx(0.3 * all).epsilon(0.25));
  }

  TEST_CASE("latency is where the vehicle was") {
    const Drive drive = small_drive();
    GnssOptions options = perfect_receiver();
    options.latency = 0.3;
    for (const GnssReading& reading : record_gnss(drive, field(), options, Timestamp(), Rng(1))) {
      const double time = std::max(0.0, reading.time.to_seconds() - 0.3);
      CHECK((reading.fix.position_ecef - map_to_ecef(drive.pose(time) * nominal_antenna_body())).norm() < 1e-6);
    }
  }
}

}  // namespace chainslam::simulator
