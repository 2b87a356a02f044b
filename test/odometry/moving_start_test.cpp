#include <doctest/doctest.h>

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>

#include "chainslam/core/random.hpp"
#include "chainslam/odometry/lidar_inertial_odometry.hpp"
#include "chainslam/odometry/lidar_odometry.hpp"
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
SO3d uphill_by(double angle) { return SO3d::exp({0, -angle, 0}); }
constexpr double steep = 0.26;  // radians: 15 degrees

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
/// 5 m/s in a turn of 1.3 deg/s, for ever: as quiet as a gyroscope's bias.
constexpr double slow_turn = 0.023;  // rad/s
SE3d turning_slowly(double t) {
  const double radius = 5 / slow_turn, heading = slow_turn * t;
  return SE3d(SO3d::exp({0, 0, heading}), {radius * std::sin(heading), radius * (1 - std::cos(heading)) - 1.5, 1.8});
}
SE3d uphill(double t) { return SE3d(uphill_by(0.12), Eigen::Vector3d::Zero()) * straight<15>(t); }
SE3d speeding_up_steeply(double t) { return SE3d(uphill_by(steep), Eigen::Vector3d::Zero()) * speeding_up(t); }
/// A lift beside the street: 1 m/s^2 for 2 s, then 2 m/s.
SE3d lifted(double t) { return SE3d(SO3d(), {0, -1.5, 1.8 + (t < 2 ? 0.5 * t * t : 2 * t - 2)}); }

struct Start {
  std::string name;
  SE3d (*pose)(double);
  World world = street();
  double max_error = 0.25;  ///< metres
  double max_angle = 0.01;  ///< radians
  double max_nees = 4;
};

/// Mean NEES of the five poses after the first relative to it, over their six degrees of freedom. (Later ones drift
/// with the local map, which their covariance is relative to.)
double start_nees(const InertialTrip& trip, const TripOutcome& run) {
  double sum = 0;
  for (std::size_t i = 1; i <= 5; ++i) {
    const Frame& frame = run.frames.at(i);
    const Vector6d error = frame.T_odom_body.local(run.T_world_odom.inverse() * trip.truth(frame.time));
    sum += error.dot(frame.covariance.ldlt().solve(error)) / 6;
  }
  return sum / 5;
}

/// Follows a start with the settings that users get, and checks every pose from the first one on.
template <class Odometry>
void check_followed(const Start& start, double imu_rate, const std::string& how) {
  const InertialTrip trip{.world = start.world,
                          .pose = start.pose,
                          .scans = 30,
                          .imu_rate = imu_rate,
                          .imu_lead = 0.3,
                          .spinner = {.rings = 32, .columns = 240, .noise = 0.02}};
  Odometry odometry;
  const TripOutcome run = follow_trip(trip, trip.packets(), odometry);
  REQUIRE(run.frames.size() == 30);
  const double nees = start_nees(trip, run);
  MESSAGE("simulated street, ", start.name, ", ", how, ": max error ", run.max_error, " m, ", run.max_angle,
          " rad, NEES ", nees, ", lost ", odometry.counts().lost_scans);
  CHECK(run.finite);
  CHECK(odometry.counts().lost_scans == 0);
  CHECK(run.max_error < start.max_error);
  CHECK(run.max_angle < start.max_angle);
  CHECK(nees < start.max_nees);
}
void check_with_imu(const Start& start) {
  check_followed<SelfCalibrating<LidarInertialOdometry<>>>(start, 100, "with IMU");
}
void check_without_imu(const Start& start) {
  check_followed<SelfCalibrating<LidarInertialOdometry<>>>(start, 0, "without IMU");
  check_followed<LidarOdometry<>>(start, 0, "LiDAR odometry");
}

}  // namespace

TEST_SUITE("odometry started in motion, simulated") {
  TEST_CASE("at 0 to 40 m/s") {
    check_with_imu({"10 m/s", straight<10>});
    check_with_imu({"40 m/s", straight<40>});
    if (quick()) return;
    for (const Start& start :
         {Start{"0 m/s", straight<0>}, Start{"25 m/s", straight<25>}, Start{"35 m/s", straight<35>}})
      check_with_imu(start);
    for (const Start& start :
         {Start{"10 m/s", straight<10>}, Start{"25 m/s", straight<25>}, Start{"40 m/s", straight<40>}})
      check_without_imu(start);
  }

  TEST_CASE("while speeding up, braking, turning, on slopes and in a lift" * doctest::skip(quick())) {
    for (const Start& start :
         {Start{"10 m/s and 3 m/s^2", speeding_up}, Start{"25 m/s and -3 m/s^2", braking},
          Start{"8 m/s and up to 0.5 rad/s", weaving},
          Start{"15 m/s uphill, 12 %", uphill, turned(street(), uphill_by(0.12))},
          Start{"10 m/s and 3 m/s^2 uphill, 15 degrees", speeding_up_steeply, turned(street(), uphill_by(steep))},
          Start{"lift, 1 m/s^2", lifted}}) {
      check_with_imu(start);
      check_without_imu(start);
    }
  }

  TEST_CASE("a slow turn from before the first scan on is no bias of the gyroscope, nor is one said to be known") {
    const InertialTrip trip{.world = street(),
                            .pose = turning_slowly,
                            .scans = 20,
                            .spinner = {.rings = 32, .columns = 240, .noise = 0.02}};
    LidarInertialOdometry<> odometry;
    double worst = 0, last = 0;
    for (const Packet& packet : trip.packets()) {
      if (!odometry.process(packet)) continue;
      constexpr int z = inertial_offset<Inertial::gyro_bias> + 2;
      last = std::abs(odometry.state().get<Inertial::gyro_bias>().value().z() - trip.gyro_bias.z());
      worst = std::max(worst, last / std::sqrt(odometry.covariance()(z, z)));
    }
    CHECK(odometry.imu_start().at_rest);
    MESSAGE("simulated street, 5 m/s and ", slow_turn, " rad/s: bias off by ", last, " rad/s after 2 s, by up to ",
            worst, " deviations on the way");
    CHECK(worst < 3);
    CHECK(last < 0.1 * slow_turn);
  }
}
