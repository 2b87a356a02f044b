#include "simulator/large_presets.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <set>
#include <utility>

#include "simulator/day.hpp"
#include "simulator/town_drive.hpp"
#include "simulator/wander.hpp"

namespace chainslam::simulator {
namespace {

using Corner = std::pair<Index, Index>;
using Streets = std::set<std::pair<Corner, Corner>>;

Streets streets_of(const Route& route) {
  Streets streets;
  for (std::size_t i = 1; i < route.size(); ++i) {
    const Corner a(route[i - 1].column, route[i - 1].row);
    const Corner b(route[i].column, route[i].row);
    streets.insert({std::min(a, b), std::max(a, b)});
  }
  return streets;
}

bool lead_on(const Route& route) {
  for (std::size_t i = 1; i < route.size(); ++i) {
    if (std::abs(route[i].column - route[i - 1].column) + std::abs(route[i].row - route[i - 1].row) != 1) return false;
    if (i > 1 && route[i].column == route[i - 2].column && route[i].row == route[i - 2].row) return false;
  }
  return true;
}

/// One session of a preset with a twentieth of its rays.
TownDrive quick_session(const char* name, std::size_t session) {
  Preset quick = *preset(name, PresetSize::small);
  quick.lidar.firings_per_revolution = quick.lidar.kind == LidarKind::vls_128 ? 12 : 24;
  return {quick, 1, session};
}

}  // namespace

TEST_SUITE("simulator/large_presets") {
  TEST_CASE("a walk stays in its window, goes from crossing to crossing, and never turns back on the spot") {
    for (std::uint64_t seed = 0; seed < 20; ++seed) {
      const Route route = wander({{1, 2}, {4, 4}}, 60, Rng(seed));
      REQUIRE(route.size() == 61);
      CHECK(lead_on(route));
      for (const Crossing& crossing : route) {
        CHECK(crossing.column >= 1);
        CHECK(crossing.column <= 4);
        CHECK(crossing.row >= 2);
        CHECK(crossing.row <= 4);
      }
      CHECK(streets_of(route).size() >= 16);  // of 17: what was not seen comes first
    }
    CHECK_THROWS_AS(static_cast<void>(wander({{1, 1}, {1, 5}}, 3, Rng(1))), std::invalid_argument);
  }

  TEST_CASE("five sessions share streets with those before, but no session only repeats another") {
    for (const char* name : {"nclt-like", "mars-like"})
      for (const PresetSize size : {PresetSize::small, PresetSize::medium, PresetSize::full}) {
        CAPTURE(name);
        CAPTURE(static_cast<int>(size));
        const Preset options = *preset(name, size);
        REQUIRE(options.sessions.size() == 5);
        Streets before;
        Index day = -1;
        std::set<Corner> starts;
        for (std::size_t i = 0; i < 5; ++i) {
          CAPTURE(i);
          const SessionPlan& session = options.sessions[i];
          CHECK(lead_on(session.route));
          CHECK(session.day > day);
          day = session.day;
          starts.insert({session.route.front().column, session.route.front().row});
          const Streets now = streets_of(session.route);
          const auto shared = std::ranges::count_if(now, [&](const auto& street) { return before.contains(street); });
          const double part = static_cast<double>(shared) / static_cast<double>(now.size());
          if (i > 0) CHECK(part >= 0.35);
          if (i == 1) CHECK(part <= 0.85);
          before.insert(now.begin(), now.end());
        }
        CHECK(starts.size() >= 4);
        CHECK(std::ranges::any_of(options.sessions, [](const SessionPlan& s) { return is_winter(s.day); }));
      }
  }

  TEST_CASE("the segway walks, leans into its starts and loses GNSS in the corridor, where people and doors are") {
    const TownDrive walk = quick_session("nclt-like", 0);
    CHECK(walk.drive().length() > 90.0);
    CHECK(walk.drive().duration() > 70.0);
    CHECK(walk.drive().duration() < 150.0);
    CHECK(walk.imu()[1].time - walk.imu()[0].time == std::chrono::milliseconds(10));
    double fastest = 0.0;
    double most_sky = 0.0;
    double least_sky = 1.0;
    double lowest = 2.0;
    double highest = -2.0;
    for (double time = 0.0; time < walk.drive().duration(); time += 0.25) {
      const Motion motion = walk.drive().motion(time);
      fastest = std::max(fastest, motion.velocity_map.norm());
      const double sky = open_sky(walk.caster(), motion.T_map_body.translation() + Eigen::Vector3d(0.0, 0.0, 0.2));
      most_sky = std::max(most_sky, sky);
      least_sky = std::min(least_sky, sky);
      const double pitch = std::asin(-(motion.T_map_body.rotation() * Eigen::Vector3d::UnitX()).z());
      lowest = std::min(lowest, pitch);
      highest = std::max(highest, pitch);
    }
    CHECK(fastest > 1.1);
    CHECK(fastest < 1.8);
    CHECK(most_sky > 0.7);
    CHECK(least_sky < 0.1);
    CHECK(highest - lowest > 0.06);
    const auto is_lost = [](const GnssReading& reading) { return reading.mode == 0; };
    CHECK(std::ranges::count_if(walk.gnss(), is_lost) > 20);  // half of 45 m at 1.3 m/s, two readings a second
    CHECK(std::ranges::count_if(walk.gnss(), is_lost) < std::ssize(walk.gnss()) / 2);
  }

  TEST_CASE("the car drives in traffic through a tunnel, its inertial unit at 10 Hz") {
    const TownDrive car = quick_session("mars-like", 0);
    CHECK(car.drive().length() > 700.0);
    CHECK(car.drive().length() < 1100.0);
    CHECK(car.imu()[1].time - car.imu()[0].time == std::chrono::milliseconds(100));
    CHECK(car.lidar().lasers() == 128);
    std::array<double, 3> counts{};
    double all = 0.0;
    bool covered = false;
    for (Index index = 10; index < car.scan_count(); index += 25) {
      for (const LidarReturn& hit : car.revolution(index).returns)
        ++counts[static_cast<std::size_t>(hit.presence)], ++all;
      covered = covered || open_sky(car.caster(), car.truth(car.scan_end(index)) * Eigen::Vector3d(0, 0, 0.3)) < 0.1;
    }
    CHECK(covered);
    CHECK(counts[2] / all > 0.08);  // the traffic
    CHECK(counts[2] / all < 0.35);
    CHECK(counts[1] / all > 0.05);  // parked cars, trees that lose their leaves
    CHECK(counts[1] / all < 0.4);
  }

  TEST_CASE("nobody drives through anything that stands") {
    for (const char* name : {"nclt-like", "mars-like"})
      for (std::size_t session = 0; session < 5; ++session) {
        CAPTURE(name);
        CAPTURE(session);
        const TownDrive drive = quick_session(name, session);
        for (double time = 0.0; time < drive.drive().duration(); time += 0.1) {
          const SE3d T = drive.drive().pose(time);
          const double height = drive.drive().path().length() > 500.0 ? -1.2 : -0.6;  // of the feelers below the body
          for (const Eigen::Vector3d& feeler :
               {Eigen::Vector3d(1.0, 0.0, 0.0), Eigen::Vector3d(0.0, 0.6, 0.0), Eigen::Vector3d(0.0, -0.6, 0.0)}) {
            const Eigen::Vector3d start = T * Eigen::Vector3d(0.0, 0.0, height);
            const Eigen::Vector3d direction = T.rotation() * feeler.normalized();
            CHECK_FALSE(drive.caster().cast(
                {start.cast<float>(), direction.cast<float>().normalized(), static_cast<float>(feeler.norm())}));
          }
        }
      }
  }

  TEST_CASE(
      "in winter trees are bare and snow lies at the kerb; some houses are finished later, some get scaffolding") {
    const auto world_on = [](Index day) {
      return make_town(preset("mars-like", PresetSize::small)->town, Rng(1).fork(0), day).world;
    };
    const World summer = world_on(0);
    const World winter = world_on(170);
    const auto leaves = [](const World& world) {
      return std::ranges::count(world.ellipsoids, Material::foliage, &Ellipsoid::material);
    };
    CHECK(leaves(summer) > 500);
    CHECK(leaves(winter) == 0);
    CHECK(winter.ellipsoids.size() > 100);
    const auto walls = [](const World& world) {
      return std::ranges::count(world.boxes, Material::wall, &Box::material);
    };
    CHECK(walls(winter) > walls(summer));
    const auto lasting = [](const World& world) {
      return std::ranges::count(world.boxes, Presence::lasting, &Box::presence);
    };
    CHECK(lasting(summer) == lasting(winter));  // what lasts is there on all days
  }
}

}  // namespace chainslam::simulator
