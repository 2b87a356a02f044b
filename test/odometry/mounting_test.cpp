#include "chainslam/odometry/detail/mounting.hpp"

#include <doctest/doctest.h>

#include <Eigen/Core>
#include <cmath>

#include "chainslam/core/random.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/odometry/detail/imu_comparison.hpp"
#include "chainslam/odometry/detail/imu_record.hpp"
#include "chainslam/odometry/imu_process.hpp"

using namespace chainslam;

namespace {

constexpr int mounting_rotation = inertial_offset<Inertial::lidar_rotation>;

Eigen::Vector3d random_vector(Rng& rng, double deviation) {
  return {rng.normal(0, deviation), rng.normal(0, deviation), rng.normal(0, deviation)};
}

InertialState random_state(Rng& rng) {
  InertialState x;
  x.get<Inertial::position>() = R3d(random_vector(rng, 30));
  x.get<Inertial::rotation>() = SO3d::exp(random_vector(rng, 1));
  x.get<Inertial::up>() = S2d::from_vector(Eigen::Vector3d(random_vector(rng, 0.3) + Eigen::Vector3d::UnitZ()));
  x.get<Inertial::lidar_position>() = R3d(random_vector(rng, 1));
  x.get<Inertial::lidar_rotation>() = SO3d::exp(random_vector(rng, 1));
  return x;
}

}  // namespace

TEST_SUITE("odometry/mounting") {
  TEST_CASE("another mounting leaves the LiDAR where it is") {
    Rng rng(3);
    for (int i = 0; i < 20; ++i) {
      CAPTURE(i);
      const InertialState before = random_state(rng);
      const SE3d other(SO3d::exp(random_vector(rng, 1)), random_vector(rng, 1));
      const InertialState x = chainslam::detail::remounted(before, other);
      CHECK(T_body_lidar(x) == other);
      const SE3d T_odom_lidar = T_odom_body(before) * T_body_lidar(before);
      CHECK(T_odom_lidar.local(T_odom_body(x) * T_body_lidar(x)).norm() < 1e-9);
    }
  }

  TEST_CASE("a doubted mounting leaves the LiDAR's pose known, and gravity as the body feels it") {
    Rng rng(4);
    for (int i = 0; i < 20; ++i) {
      CAPTURE(i);
      const InertialState x = random_state(rng);
      InertialState::Jacobian P = InertialState::Jacobian::Zero();
      chainslam::detail::doubt_mounting(P, x, 0.1, 0.02);
      CHECK(std::sqrt(P(mounting_rotation, mounting_rotation)) == doctest::Approx(0.02));
      const Vector6d lidar = lidar_pose_variances(x, P);
      for (int axis = 0; axis < 6; ++axis) CHECK(std::abs(lidar[axis]) < 1e-12);
      // A body turned by one deviation about one axis of the LiDAR, gravity turned with it.
      const auto felt = [](const InertialState& y) {
        return Eigen::Vector3d(y.get<Inertial::rotation>().inverse() * y.get<Inertial::up>().direction());
      };
      for (int axis = 0; axis < 3; ++axis) {
        InertialState::Tangent step = InertialState::Tangent::Zero();
        const int column = mounting_rotation + axis;
        for (int row = 0; row < InertialState::dof; ++row) step[row] = 1e-4 * P(row, column) / P(column, column);
        CHECK((felt(x.retract(step)) - felt(x)).norm() < 1e-7);
      }
    }
  }

  TEST_CASE("what is learnt of the mounting between two scans is no turn of the body") {
    Rng rng(5);
    const Timestamp begin = Timestamp::from_seconds(10), end = Timestamp::from_seconds(10.1);
    detail::ImuRecord imu;
    for (int i = 0; i <= 12; ++i)
      imu.add({.time = Timestamp::from_seconds(9.99 + 0.01 * i), .gyro = {0, 0, 0}, .accel = {0, 0, 9.81}});
    const InertialState from = random_state(rng);
    const SE3d learnt = T_body_lidar(from) * SE3d(SO3d::exp({0.01, -0.02, 0.01}), Eigen::Vector3d::Zero());
    const detail::ImuComparison comparison =
        chainslam::detail::compare_imu(imu, begin, from, end, chainslam::detail::remounted(from, learnt), 9.81);
    CHECK(comparison.interval == doctest::Approx(0.1));
    CHECK(comparison.rate_error.norm() < 1e-9);  // by the body's attitudes alone it would be 0.24 rad/s
    CHECK(comparison.rate < 1e-9);
  }
}
