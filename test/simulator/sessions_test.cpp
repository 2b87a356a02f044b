#include <doctest/doctest.h>

#include <algorithm>
#include <set>
#include <span>
#include <tuple>

#include "simulator/town_drive.hpp"

namespace chainslam::simulator {
namespace {

constexpr double lane_reach = 8.0;  // metres: the same street, either lane

struct Step {
  Eigen::Vector2d position;
  Eigen::Vector2d ahead;
};

/// The drive in steps of a metre.
std::vector<Step> steps_of(const TownDrive& session) {
  std::vector<Step> steps;
  for (double time = 0.0; time < session.drive().duration(); time += 0.05) {
    const SE3d T_map_body = session.drive().pose(time);
    const Eigen::Vector2d position = T_map_body.translation().head<2>();
    if (!steps.empty() && (position - steps.back().position).norm() < 1.0) continue;
    steps.push_back({position, (T_map_body.rotation() * Eigen::Vector3d::UnitX()).head<2>().normalized()});
  }
  return steps;
}

struct Sharing {
  double all = 0.0;      ///< part of a drive that lies in streets of another
  double against = 0.0;  ///< part of it where the streets are driven only against the other's direction
};

Sharing shared(const std::vector<Step>& drive, std::span<const Step> other) {
  Sharing sharing;
  for (const Step& step : drive) {
    const auto is_near = [&](const Step& there) { return (there.position - step.position).norm() < lane_reach; };
    const auto is_along = [&](const Step& there) { return is_near(there) && there.ahead.dot(step.ahead) > -0.7; };
    const double part = 1.0 / static_cast<double>(drive.size());
    if (std::ranges::none_of(other, is_near)) continue;
    sharing.all += part;
    if (std::ranges::none_of(other, is_along)) sharing.against += part;
  }
  return sharing;
}

/// Part of a drive that comes back to where it was at least 100 m before.
double revisited(const std::vector<Step>& drive) {
  std::size_t count = 0;
  for (std::size_t i = 100; i < drive.size(); ++i)
    count += std::any_of(drive.begin(), drive.begin() + static_cast<std::ptrdiff_t>(i - 100),
                         [&](const Step& there) { return (there.position - drive[i].position).norm() < lane_reach; });
  return static_cast<double>(count) / static_cast<double>(drive.size());
}

std::vector<TownDrive> three_sessions(std::uint64_t seed) {
  const Preset options = *preset("town-sessions");
  std::vector<TownDrive> sessions;
  for (std::size_t i = 0; i < options.sessions.size(); ++i) sessions.emplace_back(options, seed, i);
  return sessions;
}

/// The places of what is made of a material, told from what is elsewhere by a thousandth of a metre.
template <class Shapes, class PlaceOf>
auto places(const Shapes& shapes, Material material, const PlaceOf& place_of) {
  std::set<std::tuple<float, float, float>> found;
  for (const auto& shape : shapes)
    if (shape.material == material) found.insert(place_of(shape));
  return found;
}

auto cars_in(const World& world) {
  return places(world.boxes, Material::car,
                [](const Box& box) { return std::tuple(box.center.x(), box.center.y(), box.center.z()); });
}

auto posts_in(const World& world) {
  return places(world.cylinders, Material::metal,
                [](const Cylinder& post) { return std::tuple(post.base.x(), post.base.y(), post.base.z()); });
}

auto walls_in(const World& world) {
  return places(world.boxes, Material::wall,
                [](const Box& box) { return std::tuple(box.center.x(), box.center.y(), box.center.z()); });
}

/// Part of `now` that was there `before`.
template <class Set>
double kept(const Set& before, const Set& now) {
  const auto still = std::ranges::count_if(now, [&](const auto& place) { return before.contains(place); });
  return static_cast<double>(still) / static_cast<double>(now.size());
}

}  // namespace

TEST_SUITE("simulator/sessions") {
  TEST_CASE("three sessions start apart, loop, and share streets in the same and in opposite directions") {
    for (const std::uint64_t seed : {1U, 2U, 3U, 4U, 5U}) {
      CAPTURE(seed);
      const std::vector<TownDrive> sessions = three_sessions(seed);
      REQUIRE(sessions.size() == 3);
      std::vector<std::vector<Step>> drives;
      for (const TownDrive& session : sessions) {
        drives.push_back(steps_of(session));
        CHECK(session.drive().length() > 350.0);
        CHECK(session.drive().length() < 620.0);
        CHECK(revisited(drives.back()) > 0.05);
        CHECK(session.gnss().front().mode == 3);
        const auto is_lost = [](const GnssReading& reading) { return reading.mode == 0; };
        CHECK(std::ranges::any_of(session.gnss(), is_lost));
        CHECK(std::ranges::count_if(session.gnss(), is_lost) < std::ssize(session.gnss()) * 3 / 10);
      }
      for (const auto& [a, b] : {std::pair(0, 1), std::pair(0, 2), std::pair(1, 2)}) {
        const auto start = [&](int i) { return drives[static_cast<std::size_t>(i)].front().position; };
        CHECK((start(a) - start(b)).norm() > 30.0);
      }
      const Sharing second = shared(drives[1], drives[0]);
      const Sharing third = shared(drives[2], drives[0]);
      CHECK(second.all > 0.4);
      CHECK(second.all < 0.8);
      CHECK(second.against > 0.3);
      CHECK(third.all > 0.4);
      CHECK(third.all < 0.8);
      CHECK(third.against < 0.1);
    }
  }

  TEST_CASE("from day to day the houses stay, most posts do, and most parked cars do not") {
    const std::vector<TownDrive> sessions = three_sessions(1);
    for (const auto& [a, b] : {std::pair(0, 1), std::pair(0, 2), std::pair(1, 2)}) {
      const World& before = sessions[static_cast<std::size_t>(a)].caster().world();
      const World& now = sessions[static_cast<std::size_t>(b)].caster().world();
      CHECK(before.ground.heights == now.ground.heights);
      CHECK(walls_in(before) == walls_in(now));
      CHECK(kept(cars_in(before), cars_in(now)) == doctest::Approx(0.4).epsilon(0.2));
      CHECK(kept(posts_in(before), posts_in(now)) > 0.8);
      CHECK(kept(posts_in(before), posts_in(now)) < 0.98);
      CHECK(std::ssize(cars_in(now)) > std::ssize(cars_in(before)) * 4 / 5);
    }
  }

  TEST_CASE("one vehicle drives all sessions, and each has noise of its own") {
    const std::vector<TownDrive> sessions = three_sessions(2);
    const std::vector<TownDrive> again = three_sessions(2);
    const std::vector<TownDrive> other = three_sessions(3);
    for (std::size_t i = 0; i < sessions.size(); ++i) {
      CHECK(sessions[i].lidar().true_T_body_lidar() == sessions[0].lidar().true_T_body_lidar());
      CHECK(sessions[i].lidar().true_T_body_lidar() != other[i].lidar().true_T_body_lidar());
      CHECK(sessions[i].scan(40).cloud.positions == again[i].scan(40).cloud.positions);
      CHECK(sessions[i].scan(40).cloud.positions != other[i].scan(40).cloud.positions);
      CHECK(sessions[i].imu()[100].accel == again[i].imu()[100].accel);
      CHECK(sessions[i].gnss()[3].latitude == again[i].gnss()[3].latitude);
    }
    CHECK(sessions[0].epoch() < sessions[1].epoch() - std::chrono::hours(20));
    CHECK(sessions[1].epoch() < sessions[2].epoch() - std::chrono::hours(20));
  }

  TEST_CASE("a session that a preset does not have is refused") {
    CHECK_THROWS_AS(TownDrive(*preset("town-small"), 1, 1), std::out_of_range);
  }
}

}  // namespace chainslam::simulator
