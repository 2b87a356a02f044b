#include "chainslam/odometry/motion_predictor.hpp"

#include <doctest/doctest.h>

#include <cmath>

#include "odometry/imu_samples.hpp"

using namespace chainslam;
using chainslam::test::angle_between;
using chainslam::test::at;
using chainslam::test::sample_at;

TEST_SUITE("odometry/motion_predictor") {
  TEST_CASE("a steady motion is continued, and is not known after a pause") {
    MotionPredictor motion;
    motion.start(at(0), at(0), {});
    Vector6d twist;
    twist << 10, 0.5, 0, 0, 0.01, 0.3;
    CHECK(motion.predict(at(0), at(0.1)).error == doctest::Approx(4.0));
    SE3d pose;
    for (int i = 1; i <= 30; ++i) {
      pose = pose.retract(0.1 * twist);
      {
        const MotionPrediction prediction = motion.predict(at(0.1 * i), at(0.1 * i));
        motion.follow(prediction, prediction.twist, pose);
      }
    }
    const MotionPrediction next = motion.predict(at(3.2), at(3.2));
    CHECK(next.T_odom_body.local(pose.retract(0.2 * twist)).norm() < 1e-6);
    CHECK(next.error == doctest::Approx(0.3));
    CHECK_FALSE(next.with_gyro);
    const MotionPrediction late = motion.predict(at(8), at(8));
    CHECK(late.T_odom_body == pose);
    CHECK(late.error == doctest::Approx(4.0));
  }

  TEST_CASE("the gyroscope's rotation replaces the continued one, and its bias is found") {
    MotionPredictor motion;
    const Eigen::Vector3d bias(0.01, 0.02, -0.015), rate(0.1, -0.2, 0.7);
    for (int i = 0; i <= 2000; ++i) {
      motion.add(sample_at(0.01 * i, rate + bias));
      if (i == 0) motion.start(at(0), at(0), {});
      if (i % 10 != 0 || i == 0) continue;
      const MotionPrediction prediction = motion.predict(at(0.01 * i), at(0.01 * i));
      motion.follow(prediction, prediction.twist, SE3d(SO3d::exp(0.01 * i * rate), Eigen::Vector3d::Zero()));
    }
    CHECK((motion.gyro_bias() - bias).norm() < 1e-3);
    const MotionPrediction next = motion.predict(at(20.1), at(20.1));
    CHECK(next.with_gyro);
    CHECK(angle_between(next.T_odom_body.rotation(), SO3d::exp(20.1 * rate)) < 2e-3);
    const SweepMotion sweep = motion.sweep_motion(at(19.9), at(20), next.twist);
    CHECK(angle_between(sweep.T_end_body.front().rotation(), SO3d::exp(-0.1 * rate)) < 1e-3);
    CHECK(sweep.T_end_body.back().rotation().log().norm() < 1e-12);
  }

  TEST_CASE("an error of the last pose does not come back undamped through the sweep's correction") {
    // Standing still. A sweep measures the pose at its middle: the end found is that and half of the twist that
    // corrected the sweep.
    MotionPredictor motion;
    motion.start(at(-0.1), at(0), {});
    double end = 0;
    for (int i = 1; i <= 40; ++i) {
      const MotionPrediction prediction = motion.predict(at(0.1 * i - 0.1), at(0.1 * i));
      const double middle = i == 3 ? 0.02 : 0.0;  // metres: one bad measurement
      Vector6d twist = prediction.twist;
      for (int pass = 0; pass < 3; ++pass) {
        end = middle + 0.05 * twist.x();
        if (pass < 2) twist = motion.found_twist(prediction, twist, SE3d(SO3d(), {end, 0, 0}));
      }
      motion.follow(prediction, twist, SE3d(SO3d(), {end, 0, 0}));
      if (i > 6) CHECK(std::abs(end) < 1e-12);
    }
  }
}
