#include "simulator/spinning_lidar.hpp"

#include <doctest/doctest.h>

#include <map>
#include <numbers>

#include "simulator/place.hpp"
#include "simulator/preset.hpp"
#include "simulator/rig.hpp"

namespace chainslam::simulator {
namespace {

constexpr Timestamp epoch = Timestamp::from_nanoseconds(1'000'000'000);

LidarOptions perfect_lidar() {
  return {.range_noise = 0.0,
          .lost_returns = 0.0,
          .elevation_error_deg = 0.0,
          .range_bias = 0.0,
          .incidence_bias = 0.0,
          .mount_angle_deg = 0.0,
          .mount_shift = 0.0};
}

/// A room around the whole drive: walls at x = +-60 and y = +-50, metres.
RayCaster room() {
  World world;
  for (const double side : {-1.0, 1.0}) {
    add_box(world, {}, {side * 60.5 - 0.5, -60.0, -40.0}, {side * 60.5 + 0.5, 60.0, 40.0}, Material::wall);
    add_box(world, {}, {-60.0, side * 50.5 - 0.5, -40.0}, {60.0, side * 50.5 + 0.5, 40.0}, Material::wall);
  }
  return RayCaster(std::move(world));
}

Drive drive_in_room() {
  const Preset options = *preset("town-small");
  return Drive(options.drive, options.sessions[0].route, make_town(options.town, Rng(5)), Rng(5).fork(1));
}

/// How far a point is off the nearest wall of the room.
double off_wall(const Eigen::Vector3d& p) {
  return std::min(std::abs(std::abs(p.x()) - 60.0), std::abs(std::abs(p.y()) - 50.0));
}

}  // namespace

TEST_SUITE("simulator/spinning_lidar") {
  TEST_CASE("walls are straight after de-skewing with the truth, and bent without") {
    const RayCaster world = room();
    const Drive drive = drive_in_room();
    const SpinningLidar lidar(perfect_lidar(), Rng(1));
    double worst = 0.0;
    double worst_without = 0.0;
    for (const Index index : {50, 70, 120, 200}) {
      const LidarScan scan = lidar.to_scan(lidar.turn(world, drive, index), epoch);
      REQUIRE(scan.cloud.size() > 5000);
      REQUIRE(scan.cloud.has_times());
      const SE3d T_end = drive.pose(to_seconds(scan.end - epoch)) * nominal_T_body_lidar();
      for (std::size_t i = 0; i < scan.cloud.size(); ++i) {
        const double time = to_seconds(scan.time - epoch) + static_cast<double>(scan.cloud.time_offsets[i]);
        const Eigen::Vector3d p = scan.cloud.positions[i].cast<double>();
        worst = std::max(worst, off_wall(drive.pose(time) * (nominal_T_body_lidar() * p)));
        worst_without = std::max(worst_without, off_wall(T_end * p));
      }
    }
    // One pose serves a firing's 36 us: 0.2 mm of travel and 0.02 mrad of turning at 60 m.
    CHECK(worst < 2e-3);
    CHECK(worst_without > 0.3);
  }

  TEST_CASE("a scan's times ascend, stay within the scan, and the azimuth runs once around without a wrap inside") {
    const SpinningLidar lidar(perfect_lidar(), Rng(1));
    const LidarScan scan = lidar.to_scan(lidar.turn(room(), drive_in_room(), 60), epoch);
    CHECK(scan.time == epoch + 60 * lidar.period());
    CHECK(scan.end > scan.time);
    CHECK(scan.end <= scan.time + lidar.period());
    double previous = std::numbers::pi;
    for (std::size_t i = 0; i < scan.cloud.size(); ++i) {
      const auto offset = static_cast<double>(scan.cloud.time_offsets[i]);
      CHECK(offset >= 0.0);
      CHECK(offset <= to_seconds(scan.end - scan.time));
      if (i > 0) CHECK(scan.cloud.time_offsets[i] > scan.cloud.time_offsets[i - 1]);
      const Eigen::Vector3d p = scan.cloud.positions[i].cast<double>();
      const double azimuth = std::atan2(p.y(), p.x());
      CHECK(azimuth < previous + 1e-6);
      previous = azimuth;
    }
  }

  TEST_CASE("lasers span the data sheet's field of view") {
    const SpinningLidar hdl({}, Rng(1));
    double lowest = 0.0;
    double highest = 0.0;
    for (Index laser = 0; laser < hdl.lasers(); ++laser) {
      lowest = std::min(lowest, hdl.nominal_elevation(laser));
      highest = std::max(highest, hdl.nominal_elevation(laser));
    }
    CHECK(lowest * 180.0 / std::numbers::pi == doctest::Approx(-30.67).epsilon(1e-3));
    CHECK(highest * 180.0 / std::numbers::pi == doctest::Approx(10.67).epsilon(1e-3));
  }

  TEST_CASE("range noise and each laser's bias have the stated size") {
    LidarOptions options = perfect_lidar();
    options.range_noise = 0.02;
    options.range_bias = 0.02;
    const RayCaster world = room();
    const Drive drive = drive_in_room();
    const SpinningLidar noisy(options, Rng(2));
    const SpinningLidar exact(perfect_lidar(), Rng(2));
    std::map<int, std::vector<double>> errors;  // by laser
    for (Index index = 0; index < 4; ++index) {
      std::map<std::pair<int, int>, double> truth;
      for (const LidarReturn& hit : exact.turn(world, drive, index).returns)
        truth[{hit.firing, hit.laser}] = static_cast<double>(hit.position.norm());
      for (const LidarReturn& hit : noisy.turn(world, drive, index).returns)
        if (const auto range = truth.find({hit.firing, hit.laser}); range != truth.end())
          errors[hit.laser].push_back(static_cast<double>(hit.position.norm()) - range->second);
    }
    REQUIRE(errors.size() == 32);
    double squares = 0.0;
    std::size_t count = 0;
    for (const auto& [laser, values] : errors) {
      double mean = 0.0;
      for (const double value : values) mean += value / static_cast<double>(values.size());
      CHECK(std::abs(mean) > 0.009);  // 0.5 to 1.5 times 2 cm
      CHECK(std::abs(mean) < 0.031);
      for (const double value : values) squares += (value - mean) * (value - mean);
      count += values.size() - 1;
    }
    CHECK(count > 20000);
    CHECK(std::sqrt(squares / static_cast<double>(count)) == doctest::Approx(0.02).epsilon(0.02));
  }

  TEST_CASE("the true mounting is off the nominal one by the stated amounts") {
    const SpinningLidar lidar({}, Rng(3));
    const SE3d error = nominal_T_body_lidar().inverse() * lidar.true_T_body_lidar();
    CHECK(error.rotation().log().norm() * 180.0 / std::numbers::pi == doctest::Approx(LidarOptions{}.mount_angle_deg));
    CHECK(error.translation().norm() == doctest::Approx(LidarOptions{}.mount_shift));
  }

  TEST_CASE("a sensor is off by the same every day, its noise is not the same") {
    const RayCaster world = room();
    const Drive drive = drive_in_room();
    LidarOptions lasting;
    lasting.range_noise = lasting.lost_returns = 0.0;
    const auto ranges = [&](const LidarOptions& options, Index day) {
      std::map<std::pair<int, int>, float> found;
      for (const LidarReturn& hit : SpinningLidar(options, Rng(4), day).turn(world, drive, 9).returns)
        found[{hit.firing, hit.laser}] = hit.position.norm();
      return found;
    };
    const auto mean_difference = [&](const LidarOptions& options) {
      const auto first = ranges(options, 0);
      double sum = 0.0;
      std::size_t count = 0;
      for (const auto& [ray, range] : ranges(options, 21))
        if (const auto before = first.find(ray); before != first.end()) {
          sum += static_cast<double>(std::abs(range - before->second));
          ++count;
        }
      REQUIRE(count > 5000);
      return sum / static_cast<double>(count);
    };
    CHECK(mean_difference(lasting) == 0.0);
    // The mean size of a difference of two normal values: 2 / sqrt(pi) standard deviations.
    CHECK(mean_difference({}) == doctest::Approx(2.0 / std::sqrt(std::numbers::pi) * 0.015).epsilon(0.05));
  }

  TEST_CASE("far and grazing surfaces return less") {
    World world;
    HeightField& ground = world.ground;
    ground.origin = {-150.0F, -150.0F};
    ground.spacing = 300.0F;
    ground.columns = ground.rows = 2;
    ground.heights.assign(4, 0.0F);
    ground.materials.assign(4, Material::road);
    const RayCaster plain(std::move(world), 300.0F);
    const Preset options = *preset("town-small");
    TownOptions flat = options.town;
    flat.steepness = 0.0;
    const Drive drive(options.drive, options.sessions[0].route, make_town(flat, Rng(5)), Rng(5).fork(1));
    const SpinningLidar lidar({}, Rng(6));
    std::array<int, 32> returns{};
    constexpr Index scans = 3;
    for (Index index = 0; index < scans; ++index)
      for (const LidarReturn& hit : lidar.turn(plain, drive, index).returns) ++returns[hit.laser];
    const auto part = [&](std::size_t laser) {
      return static_cast<double>(returns[laser]) / (scans * lidar.options().firings_per_revolution);
    };
    CHECK(part(0) > 0.98);   // 30.7 degrees down: 4 m
    CHECK(part(12) > 0.95);  // 14.7 degrees down: 7.5 m
    // By the radar equation, 1 - 2^-(0.15 / 0.1 * cos(incidence) * (100 m / range)^2) from 1.9 m above the road; the
    // mounting leans by 0.8 degrees, which makes some azimuths see farther than others.
    CHECK(part(9) == doctest::Approx(0.64).epsilon(0.1));   // 4 degrees down: 27 m
    CHECK(part(11) == doctest::Approx(0.26).epsilon(0.2));  // 2.7 degrees down: 41 m
    CHECK(part(31) == 0.0);                                 // up
  }

  TEST_CASE("a number of firings that does not fill packets is refused") {
    CHECK_THROWS_AS(SpinningLidar({.firings_per_revolution = 601}, Rng(1)), std::invalid_argument);
    CHECK_THROWS_AS(SpinningLidar({.firings_per_revolution = 0}, Rng(1)), std::invalid_argument);
  }

  TEST_CASE("every make has its data sheet's lasers, field of view, rings and firing time") {
    struct Sheet {
      LidarKind kind;
      std::size_t lasers;
      double lowest, highest;  // degrees
      double last_delay;       // microseconds
    };
    for (const Sheet& sheet :
         {Sheet{LidarKind::hdl_32e, 32, -30.67, 10.67, 31 * 1.152},
          Sheet{LidarKind::vlp_16, 16, -15.0, 15.0, 15 * 2.304}, Sheet{LidarKind::os1_64, 64, -16.611, 16.611, 0.0},
          Sheet{LidarKind::vls_128, 128, -25.0, 15.0, 16 * 2.665}}) {
      const LidarModel& model = lidar_model(sheet.kind);
      CAPTURE(model.name);
      REQUIRE(model.channels.size() == sheet.lasers);
      std::vector<double> by_ring(sheet.lasers, -90.0);
      double widest = 0.0;
      for (const LidarChannel& channel : model.channels) {
        by_ring[channel.ring] = channel.elevation_deg;
        widest = std::max(widest, std::abs(channel.azimuth_deg));
        CHECK(channel.delay <= model.channels.back().delay);
      }
      CHECK(std::ranges::is_sorted(by_ring));
      CHECK(std::ranges::adjacent_find(by_ring) == by_ring.end());  // no two lasers on one ring
      CHECK(by_ring.front() == doctest::Approx(sheet.lowest).epsilon(1e-3));
      CHECK(by_ring.back() == doctest::Approx(sheet.highest).epsilon(1e-3));
      CHECK(to_seconds(model.channels.back().delay) == doctest::Approx(1e-6 * sheet.last_delay));
      CHECK(widest < 6.5);
      CHECK(model.firings_per_revolution % model.firings_per_packet == 0);
      LidarOptions options = perfect_lidar();
      options.kind = sheet.kind;
      options.firings_per_revolution = 240;
      const SpinningLidar lidar(options, Rng(1));
      const Revolution turn = lidar.turn(room(), drive_in_room(), 0);
      CHECK(turn.returns.size() > sheet.lasers * 120);
      for (const LidarReturn& hit : turn.returns) {
        const Eigen::Vector3d p = hit.position.cast<double>();
        CHECK(std::asin(p.z() / p.norm()) == doctest::Approx(lidar.nominal_elevation(hit.laser)).epsilon(1e-4));
      }
    }
  }

  TEST_CASE("a wide beam mixes returns across low steps, and only there") {
    World world;
    for (int step = 0; step < 60; ++step)  // a wall of slats, every other 0.5 m behind
      add_box(world, {}, {40.0 + (step % 2) * 0.5, step - 30.0, -40.0}, {42.0, step - 29.0, 40.0}, Material::wall);
    add_box(world, {}, {-42.0, -60.0, -40.0}, {-40.0, 60.0, 40.0}, Material::wall);
    const RayCaster slats(std::move(world));
    LidarOptions options = perfect_lidar();
    const auto between = [&](double width) {
      options.beam_width_deg = width;
      const SpinningLidar lidar(options, Rng(1));
      const Drive drive = drive_in_room();
      std::pair<int, int> count{};  // in between in front, and off the plain wall behind
      for (const LidarReturn& hit : lidar.turn(slats, drive, 0).returns) {
        const Eigen::Vector3d p = drive.pose(0.0) * (lidar.true_T_body_lidar() * hit.position.cast<double>());
        if (p.x() > 0.0 && std::abs(p.y()) < 25.0) count.first += p.x() > 40.03 && p.x() < 40.47;
        if (p.x() < 0.0 && std::abs(p.y()) < 25.0) count.second += std::abs(p.x() + 40.0) > 0.1;
      }
      return count;
    };
    const auto [without, behind] = between(0.0);
    const auto [with, still_behind] = between(0.2);
    CHECK(behind == 0);
    CHECK(still_behind == 0);
    CHECK(with > without + 50);
  }

  TEST_CASE("a clock that is off makes scans of another time") {
    LidarOptions options = perfect_lidar();
    options.clock_offset = 0.1;
    const RayCaster world = room();
    const Drive drive = drive_in_room();
    const auto late = SpinningLidar(options, Rng(1)).turn(world, drive, 70);
    const auto next = SpinningLidar(perfect_lidar(), Rng(1)).turn(world, drive, 71);
    std::map<std::pair<int, int>, Eigen::Vector3f> expected;
    for (const LidarReturn& hit : next.returns) expected[{hit.firing, hit.laser}] = hit.position;
    std::size_t found = 0;
    for (const LidarReturn& hit : late.returns) {
      const auto there = expected.find({hit.firing, hit.laser});
      if (there == expected.end()) continue;
      ++found;
      CHECK((hit.position - there->second).norm() < 1e-3F);
    }
    CHECK(found > next.returns.size() * 9 / 10);  // which returns are lost is drawn for each revolution
  }
}

}  // namespace chainslam::simulator
