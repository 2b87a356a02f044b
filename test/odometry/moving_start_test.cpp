#include <doctest/doctest.h>

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <string>

#include "chainslam/core/random.hpp"
#include "chainslam/odometry/lidar_inertial_odometry.hpp"
#include "chainslam/odometry/self_calibrating.hpp"
#include "odometry/inertial_trip.hpp"
#include "support/quick.hpp"

using namespace chainslam;
using namespace chainslam::test;

namespace {

/// A street along x from -60 m to 240 m: ground, houses of all widths and setbacks, parked cars, posts.
World street() {
  Rng rng(5);
  World world;
  world.panels.push_back({{90, 0, 0}, {160, 0, 0}, {0, 40, 0}});
  for (const double side : {-1.0, 1.0})
    for (double x = -60; x < 240;) {
      const double half_width = rng.uniform(3, 9), front = rng.uniform(7, 10), half_height = rng.uniform(2, 6);
      world.add_box({x + half_width, side * (front + 5), half_height}, {half_width, 5, half_height});
      if (rng.uniform() < 0.6) world.add_box({x + half_width, side * 5.2, 0.75}, {2.1, 0.9, 0.75});
      world.add_box({x, side * 6.4, 3}, {0.12, 0.12, 3});
      x += 2 * half_width + rng.uniform(0, 6);
    }
  return world;
}
World turned(World world, const SO3d& R) {
  for (Panel& panel : world.panels) panel = {R * panel.center, R * panel.u, R * panel.v};
  return world;
}
const SO3d& slope() {
  static const SO3d R = SO3d::exp({0, -0.12, 0});  // uphill along x: 12 %
  return R;
}

/// In the middle of the lane, 1.8 m above the ground, from x = 0 on. A car's body nods and sways a little.
template <int Speed>
SE3d straight(double t) {
  return SE3d(SO3d::exp({0.01 * std::sin(2 * t), 0.01 * std::sin(3 * t), 0}), {Speed * t, -1.5, 1.8});
}
/// 3 m/s^2 more or less.
SE3d speeding_up(double t) { return SE3d(SO3d(), {10 * t + 1.5 * t * t, -1.5, 1.8}); }
SE3d braking(double t) { return SE3d(SO3d(), {25 * t - 1.5 * t * t, -1.5, 1.8}); }
/// 8 m/s and 0.5 rad/s from one side of the street to the other and back.
SE3d weaving(double t) {
  const double heading = 0.35 * std::sin(1.4 * t);
  return SE3d(SO3d::exp({0, 0, heading}), {8 * t, -0.25 * 8 * std::cos(1.4 * t), 1.8});
}
SE3d uphill(double t) { return SE3d(slope(), Eigen::Vector3d::Zero()) * straight<15>(t); }

struct Start {
  std::string name;
  SE3d (*pose)(double);
  World world = street();
  double max_error = 0.25;  ///< metres
};

/// Follows a start with the settings that users get, and checks every pose from the first one on.
void check_followed(const Start& start, double imu_rate) {
  InertialTrip trip{.world = start.world,
                    .pose = start.pose,
                    .scans = 30,
                    .imu_rate = imu_rate,
                    .imu_lead = 0.3,
                    .spinner = {.rings = 32, .columns = 240, .noise = 0.02}};
  SelfCalibrating<LidarInertialOdometry<>> odometry;
  const TripOutcome run = follow_trip(trip, trip.packets(), odometry);
  MESSAGE("simulated street, ", start.name, std::string(imu_rate > 0 ? "" : ", without IMU"), ": max error ",
          run.max_error, " m, ", run.max_angle, " rad, lost ", odometry.counts().lost_scans);
  CHECK(run.finite);
  CHECK(run.frames.size() == 30);
  CHECK(odometry.counts().lost_scans == 0);
  CHECK(run.max_error < start.max_error);
  CHECK(run.max_angle < 0.01);
}

}  // namespace

TEST_SUITE("odometry started in motion, simulated") {
  TEST_CASE("at 10, 25 and 35 m/s") {
    check_followed({"10 m/s", straight<10>}, 100);
    check_followed({"35 m/s", straight<35>}, 100);
    if (quick()) return;
    check_followed({"25 m/s", straight<25>}, 100);
    check_followed({"10 m/s", straight<10>}, 0);
    check_followed({"25 m/s", straight<25>}, 0);
    check_followed({"35 m/s", straight<35>}, 0);
  }

  TEST_CASE("while speeding up, braking, turning and on a slope" * doctest::skip(quick())) {
    check_followed({"10 m/s and 3 m/s^2", speeding_up}, 100);
    check_followed({"25 m/s and -3 m/s^2", braking}, 100);
    // The second pose is 0.45 m off along the street, whose walls hardly show that direction.
    check_followed({"8 m/s and up to 0.5 rad/s", weaving, street(), 0.5}, 100);
    check_followed({"15 m/s uphill, 12 %", uphill, turned(street(), slope())}, 100);
  }
}
