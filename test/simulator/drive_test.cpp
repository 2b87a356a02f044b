#include "simulator/drive.hpp"

#include <doctest/doctest.h>

#include <numbers>

#include "simulator/motion_check.hpp"
#include "simulator/preset.hpp"

namespace chainslam::simulator {
namespace {

struct Session {
  Preset options;
  Town town;
  Drive drive;

  Session(const char* name, std::uint64_t seed)
      : options(*preset(name)),
        town(make_town(options.town, Rng(seed))),
        drive(options.drive, options.sessions[0].route, town, Rng(seed).fork(1)) {}
};

}  // namespace

TEST_SUITE("simulator/drive") {
  TEST_CASE("velocity, acceleration and rates are the derivatives of the pose") {
    const Session session("town-small", 1);
    test::check_derivatives(session.drive.duration(), [&](double t) { return session.drive.motion(t); });
  }

  TEST_CASE("the town's drive is long, loops, ends at rest across the street from its start and stops on the way") {
    for (const std::uint64_t seed : {1U, 2U, 3U, 4U, 5U}) {
      CAPTURE(seed);
      const Session session("town", seed);
      const Drive& drive = session.drive;
      CHECK(drive.length() > 750.0);
      CHECK(drive.length() < 1000.0);
      CHECK(drive.duration() > 100.0);
      CHECK(drive.duration() < 145.0);
      CHECK(drive.motion(0.0).velocity_map.norm() < 1e-3);
      CHECK(drive.motion(1.5).velocity_map.norm() < 1e-3);
      CHECK(drive.motion(drive.duration()).velocity_map.norm() < 1e-3);
      const SE3d round_trip = drive.pose(0.0).inverse() * drive.pose(drive.duration());
      // On the other lane, facing the other way.
      CHECK((round_trip.translation() - Eigen::Vector3d(0, 2 * DriveOptions().lane, 0)).norm() < 0.2);
      CHECK(round_trip.rotation().log().norm() > 3.1);

      double fastest = 0.0;
      double lateral = 0.0;
      bool stopped = false;
      double highest = -1e9;
      double lowest = 1e9;
      for (double t = 10.0; t < drive.duration() - 10.0; t += 0.05) {
        const Motion motion = drive.motion(t);
        fastest = std::max(fastest, motion.velocity_map.norm());
        lateral = std::max(lateral, motion.acceleration_map.head<2>().norm());
        stopped = stopped || motion.velocity_map.norm() < 0.05;
        highest = std::max(highest, motion.T_map_body.translation().z());
        lowest = std::min(lowest, motion.T_map_body.translation().z());
      }
      CHECK(fastest > 7.0);
      CHECK(fastest < 11.5);
      CHECK(lateral < 5.0);
      CHECK(stopped);
      CHECK(highest - lowest > 1.5);
    }
  }

  TEST_CASE("the vehicle stands on the road and leans with it") {
    const Session session("town-small", 2);
    for (double t = 0.0; t < session.drive.duration(); t += 0.5) {
      const Motion motion = session.drive.motion(t);
      const Eigen::Vector3d p = motion.T_map_body.translation();
      const double road = session.town.terrain.height(p.head<2>());
      CHECK(std::abs(p.z() - road - session.options.drive.body_height) < 0.02);  // vibration, and the spline's rounding
      const Eigen::Vector2d slope = session.town.terrain.slope(p.head<2>());
      const Eigen::Vector3d normal = Eigen::Vector3d(-slope.x(), -slope.y(), 1.0).normalized();
      const Eigen::Vector3d up = motion.T_map_body.rotation() * Eigen::Vector3d::UnitZ();
      CHECK(std::acos(std::min(1.0, up.dot(normal))) < 0.05);  // dives and leans by up to 0.008 rad per m/s^2
      if (motion.velocity_map.norm() < 1.0) continue;
      const Eigen::Vector3d ahead = motion.T_map_body.rotation() * Eigen::Vector3d::UnitX();
      CHECK(ahead.dot(motion.velocity_map.normalized()) > 0.995);
    }
  }

  TEST_CASE("a route that turns back on itself, or goes nowhere, is refused") {
    const StreetGrid streets({}, Rng(1));
    CHECK_THROWS_AS(static_cast<void>(follow_lane(streets, {{0, 0}, {1, 0}, {0, 0}}, {})), std::invalid_argument);
    CHECK_THROWS_AS(static_cast<void>(follow_lane(streets, {{0, 0}, {1, 0}}, {})), std::invalid_argument);
    CHECK_THROWS_AS(static_cast<void>(follow_lane(streets, {{0, 0}, {1, 0}, {99, 0}}, {})), std::invalid_argument);
  }
}

}  // namespace chainslam::simulator
