#include "simulator/pose_spline.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <numbers>

#include "simulator/motion_check.hpp"
#include "simulator/recorded_drive.hpp"
#include "support/kitti_drive.hpp"
#include "support/property.hpp"

namespace chainslam::simulator {
namespace {

using chainslam::test::for_all;
using chainslam::test::kitti_drive;

/// A drive round a circle of 20 m at 8 m/s, pitching with the hills; all derivatives in closed form.
struct Circle {
  static constexpr double radius = 20.0, turn = 0.4;

  [[nodiscard]] static SE3d pose(double t) {
    return SE3d(from_roll_pitch_yaw(0.0, 0.05 * std::sin(t), turn * t),
                {radius * std::sin(turn * t), -radius * std::cos(turn * t), 0.5 * std::cos(t)});
  }
  [[nodiscard]] static Eigen::Vector3d acceleration(double t) {
    return {-radius * turn * turn * std::sin(turn * t), radius * turn * turn * std::cos(turn * t), -0.5 * std::cos(t)};
  }
  [[nodiscard]] static Eigen::Vector3d rate(double t) {
    const double pitch = 0.05 * std::sin(t);
    return {-std::sin(pitch) * turn, 0.05 * std::cos(t), std::cos(pitch) * turn};
  }
  [[nodiscard]] static Trajectory sampled(double interval, double duration) {
    Trajectory trajectory;
    for (double t = 0.0; t <= duration; t += interval) {
      trajectory.times.push_back(Timestamp(seconds(t)));
      trajectory.poses.push_back(pose(t));
    }
    return trajectory;
  }
};

/// A wild but smooth motion, upright or not, at uneven times.
Trajectory random_motion(Rng& rng) {
  Trajectory trajectory;
  SE3d pose(SO3d::exp({rng.uniform(-3.0, 3.0), rng.uniform(-1.0, 1.0), rng.uniform(-3.0, 3.0)}),
            Eigen::Vector3d::Zero());
  Eigen::Matrix<double, 6, 1> twist = Eigen::Matrix<double, 6, 1>::Zero();
  for (double t = 0.0; t < 8.0; t += rng.uniform(0.05, 0.15)) {
    for (int i = 0; i < 6; ++i) twist[i] = 0.9 * twist[i] + rng.normal(0.0, i < 3 ? 0.1 : 0.02);
    pose = pose * SE3d::exp(twist);
    trajectory.times.push_back(Timestamp(seconds(t)));
    trajectory.poses.push_back(pose);
  }
  return trajectory;
}

}  // namespace

TEST_SUITE("simulator/pose_spline") {
  TEST_CASE("velocity, acceleration and rates are the derivatives of the pose") {
    for_all(20, [](Rng& rng, int) {
      const PoseSpline spline(random_motion(rng));
      test::check_derivatives(spline.duration() - 0.05, [&](double t) { return spline.motion(t); });
    });
  }

  TEST_CASE("it follows a smooth drive: pose, rates and accelerations, at 10 Hz and at NCLT's 2.5 Hz") {
    for (const double interval : {0.1, 0.4}) {
      CAPTURE(interval);
      const PoseSpline spline(Circle::sampled(interval, 30.0));
      for (double t = 1.0; t < 29.0; t += 0.037) {
        const Motion motion = spline.motion(t);
        const SE3d off = Circle::pose(t).inverse() * motion.T_map_body;
        CHECK(off.translation().norm() < 5e-3);
        CHECK(off.rotation().log().norm() < 2e-4);
        CHECK((motion.acceleration_map - Circle::acceleration(t)).norm() < 0.02);
        CHECK((motion.rate_body - Circle::rate(t)).norm() < 5e-4);
      }
    }
  }

  TEST_CASE("KITTI's truth as a spline agrees with the IMU measured on the drive, best with the defaults") {
    const auto drive = kitti_drive("07", 0.1040);
    if (!drive) return;
    const auto agreement = [&](const PoseSplineOptions& options) {
      // Levelled by the drive's own specific forces, as `RecordedDrive` does.
      const PoseSpline raw(drive->trajectory, options);
      Eigen::Vector3d up = Eigen::Vector3d::Zero();
      for (const ImuSample& sample : drive->imu)
        up += raw.pose(to_seconds(sample.time - Timestamp())).rotation() * sample.accel;
      const SE3d level(SO3d::from_quaternion(Eigen::Quaterniond::FromTwoVectors(up, Eigen::Vector3d::UnitZ())),
                       Eigen::Vector3d::Zero());
      return compare(PoseSpline(transformed(level, drive->trajectory), options), drive->imu, Timestamp());
    };
    const ImuAgreement best = agreement({});
    CHECK(best.lag == doctest::Approx(0.064).epsilon(0.1));  // z rates alone: 65.8 ms; about x and y 52 to 61 ms
    CHECK(best.gyro_signal > 0.18);
    CHECK(best.gyro_rms < 0.0063);  // of 0.19 rad/s
    CHECK(best.accel_signal > 1.3);
    CHECK(best.accel_rms < 0.31);  // of 1.4 m/s^2
    for (const double factor : {0.2, 5.0}) {
      CAPTURE(factor);
      PoseSplineOptions other;
      other.position_smoothing *= factor;
      CHECK(agreement(other).accel_rms > 1.05 * best.accel_rms);
      other = {};
      other.rotation_smoothing *= factor;
      CHECK(agreement(other).gyro_rms > 1.03 * best.gyro_rms);
    }
    PoseSplineOptions coarse;
    coarse.longest_knot = 0.4;
    const auto every_fourth = [&] {
      Trajectory part;
      for (std::size_t i = 0; i < drive->trajectory.size(); i += 4) {
        part.times.push_back(drive->trajectory.times[i]);
        part.poses.push_back(drive->trajectory.poses[i]);
      }
      return part;
    };
    // Knots as far apart as rare poses follow a motion less closely than the default's.
    const auto off = [&](const PoseSplineOptions& options) {
      const PoseSpline spline(every_fourth(), options);
      double sum = 0.0;
      for (std::size_t i = 40; i + 40 < drive->trajectory.size(); ++i) {
        const double t = to_seconds(drive->trajectory.times[i] - Timestamp());
        sum += (spline.pose(t).translation() - drive->trajectory.poses[i].translation()).squaredNorm();
      }
      return std::sqrt(sum / static_cast<double>(drive->trajectory.size() - 80));
    };
    CHECK(off(coarse) > 1.02 * off({}));
  }

  TEST_CASE("what no spline can follow is refused") {
    Trajectory trajectory = Circle::sampled(0.1, 3.0);
    CHECK_NOTHROW(PoseSpline{trajectory});
    Trajectory back = trajectory;
    std::swap(back.times[3], back.times[4]);
    CHECK_THROWS_AS(PoseSpline{back}, std::invalid_argument);
    Trajectory broken = trajectory;
    broken.poses[5] = SE3d(SO3d(), {std::nan(""), 0.0, 0.0});
    CHECK_THROWS_AS(PoseSpline{broken}, std::invalid_argument);
    CHECK_THROWS_AS(PoseSpline{Circle::sampled(0.1, 0.5)}, std::invalid_argument);
    trajectory.times.clear();
    CHECK_THROWS_AS(PoseSpline{trajectory}, std::invalid_argument);
  }
}

}  // namespace chainslam::simulator
