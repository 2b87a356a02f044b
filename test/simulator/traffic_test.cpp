#include "simulator/traffic.hpp"

#include <doctest/doctest.h>

#include "simulator/furniture.hpp"
#include "simulator/place.hpp"
#include "simulator/preset.hpp"
#include "simulator/town_drive.hpp"

namespace chainslam::simulator {
namespace {

/// The small town's drive with others around it.
struct BusyDrive {
  Preset options = *preset("town-small");
  Town town = make_town(options.town, Rng(3));
  Drive drive = Drive(options.drive, options.sessions[0].route, town, Rng(3).fork(1));

  [[nodiscard]] Traffic traffic(const TrafficOptions& with) const { return {with, drive, Rng(9)}; }
};

}  // namespace

TEST_SUITE("simulator/traffic") {
  TEST_CASE("a ray meets somebody who moves where it would meet the same shapes standing there") {
    World car;
    add_car(car, {}, Rng(4));
    const Place place{.origin = {12.0, -3.0, 0.5}, .rotation = yawed(0.7)};
    World standing;
    add_car(standing, place, Rng(4));
    const RayCaster caster(std::move(standing));
    const Passing passing{.shape = &car,
                          .radius = 3.0F,
                          .height = 2.0F,
                          .start = (place.origin - Eigen::Vector3d(1.0, 0.0, 0.0)).cast<float>(),
                          .stop = (place.origin + Eigen::Vector3d(3.0, 0.0, 0.0)).cast<float>(),
                          .R_map_own = place.rotation.cast<float>()};
    const std::array near{Halted(passing, 0.25F)};
    Rng rng(1);
    int hits = 0;
    for (int i = 0; i < 2000; ++i) {
      const Eigen::Vector3d direction(1.0, rng.uniform(-0.5, 0.1), rng.uniform(-0.1, 0.1));
      const Ray ray{{0.0F, 0.0F, 1.2F}, direction.normalized().cast<float>(), 50.0F};
      const auto expected = caster.cast(ray);
      const auto met = meet(near, ray);
      REQUIRE(met.has_value() == expected.has_value());
      if (!met) continue;
      ++hits;
      CHECK(met->distance == doctest::Approx(expected->distance).epsilon(1e-4));
      CHECK(met->material == expected->material);
    }
    CHECK(hits > 300);
    CHECK_FALSE(meet(near, {{0.0F, 0.0F, 1.2F}, Eigen::Vector3f(-1.0F, 0.0F, 0.0F), 50.0F}));
  }

  TEST_CASE("companions stay near all the way, others pass by, and all stand on the road") {
    const BusyDrive busy;
    const Traffic along = busy.traffic({.companions = 2});
    const Traffic against = busy.traffic({.between_oncoming = 3.0});
    const Traffic people = busy.traffic({.between_people = 2.0});
    std::size_t met = 0;
    for (double time = 3.0; time < busy.drive.duration() - 3.0; time += 0.5) {
      const Eigen::Vector3d here = busy.drive.pose(time).translation();
      const double behind = busy.drive.driven(time);
      const auto companions = along.during(busy.drive, busy.town.terrain, time, time + 0.1);
      if (behind > 20.0 && behind < busy.drive.length() - 20.0) CHECK(companions.size() == 2);
      for (const Passing& one : companions) {
        CHECK((one.start.cast<double>() - here).norm() < 25.0);
        CHECK((one.start.cast<double>() - here).norm() > 4.0);  // nobody drives into anybody
      }
      met += against.during(busy.drive, busy.town.terrain, time, time + 0.1).size();
      for (const Traffic* traffic : {&along, &against, &people})
        for (const Passing& one : traffic->during(busy.drive, busy.town.terrain, time, time + 0.1)) {
          const Eigen::Vector3d p = one.start.cast<double>();
          CHECK(p.z() == doctest::Approx(busy.town.terrain.height(p.head<2>())).epsilon(1e-3));
          const auto later = traffic->during(busy.drive, busy.town.terrain, time + 0.1, time + 0.2);
          const bool goes_on =
              std::ranges::any_of(later, [&](const Passing& next) { return (next.start - one.stop).norm() < 1e-3F; });
          const bool at_the_end =
              later.size() < traffic->during(busy.drive, busy.town.terrain, time, time + 0.1).size();
          CHECK((goes_on || at_the_end));
        }
    }
    CHECK(met > 20);
    CHECK(Traffic().during(busy.drive, busy.town.terrain, 5.0, 5.1).empty());
  }

  TEST_CASE("the sensor sees them, and its returns say so") {
    Preset quick = *preset("town-small");
    quick.lidar.firings_per_revolution = 120;
    const auto moving = [&](const TrafficOptions& traffic) {
      quick.traffic = traffic;
      const TownDrive session(quick, 1);
      std::array<int, 3> counts{};
      for (const Index index : {60, 100, 140, 180})
        for (const LidarReturn& hit : session.revolution(index).returns)
          ++counts[static_cast<std::size_t>(hit.presence)];
      CHECK(counts[0] > 4000);
      CHECK(counts[1] > 100);  // cars that are parked today
      return counts[2];
    };
    CHECK(moving({}) == 0);
    CHECK(moving({.companions = 2}) > 100);
    CHECK(moving({.between_people = 1.0}) > 20);
  }
}

}  // namespace chainslam::simulator
