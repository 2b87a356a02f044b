#include "chainslam/odometry/detail/first_sweep.hpp"

#include <doctest/doctest.h>

#include <Eigen/Core>
#include <optional>

#include "chainslam/core/random.hpp"
#include "odometry/imu_samples.hpp"
#include "support/property.hpp"

using namespace chainslam;
using chainslam::test::at;
using chainslam::test::for_all;
using chainslam::test::sample_at;

namespace {

SE3d pose_at(const SweepMotion& motion, double share) {
  const double place = share * static_cast<double>(motion.T_end_body.size() - 1);
  return motion.T_end_body[static_cast<std::size_t>(place + 0.5)];
}

}  // namespace

TEST_SUITE("odometry/first_sweep") {
  TEST_CASE("turns as the gyroscope measured, less its bias, and moves by the twist") {
    for_all(20, [](Rng& rng, int) {
      const Eigen::Vector3d rate(rng.uniform(-2, 2), rng.uniform(-2, 2), rng.uniform(-2, 2));
      const Eigen::Vector3d bias(0.02, -0.01, 0.03);
      detail::ImuRecord imu;
      for (int i = 0; i <= 30; ++i) imu.add(sample_at(0.01 * i, rate + bias));
      const detail::GyroTurn turn(imu, at(0.1), at(0.2), bias);
      REQUIRE(turn.measured());
      Vector6d twist = Vector6d::Zero();
      twist.head<3>() = Eigen::Vector3d(rng.uniform(-40, 40), rng.uniform(-2, 2), rng.uniform(-2, 2));
      twist.tail<3>().setConstant(5);  // measured, so it does not count
      const SweepMotion motion = turn.with(twist);
      CHECK(motion.duration == doctest::Approx(0.1));
      const SE3d begin = pose_at(motion, 0), end = pose_at(motion, 1);
      CHECK(begin.rotation().local(SO3d::exp(-0.1 * rate)).norm() < 1e-9);
      CHECK((begin.translation() + 0.1 * twist.head<3>()).norm() < 1e-9);
      CHECK(end.log().norm() < 1e-9);
    });
  }

  TEST_CASE("moves by the twist alone where the gyroscope left a hole, has a stuck axis, or is missing") {
    const Vector6d twist = (Vector6d() << 8, 0, 0, 0, 0, 0.5).finished();
    detail::ImuRecord missing, hole, stuck;
    for (int i = 0; i <= 10; ++i) hole.add(sample_at(0.01 * i, {0, 0, 1}));
    hole.add(sample_at(1, {0, 0, 1}));
    for (int i = 0; i <= 30; ++i) {
      ImuSample sample = sample_at(0.01 * i, {0, 0, 1});
      sample.rate_measured = false;
      stuck.add(sample);
    }
    for (const detail::ImuRecord* imu : {&missing, &hole, &stuck}) {
      const detail::GyroTurn turn(*imu, at(0.1), at(0.2), Eigen::Vector3d::Zero());
      CHECK(!turn.measured());
      const Vector6d back = -0.1 * twist;
      CHECK(pose_at(turn.with(twist), 0).local(SE3d::exp(back)).norm() < 1e-9);
    }
  }
}
