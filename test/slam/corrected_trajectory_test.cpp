#include "chainslam/slam/slam_map.hpp"

#include <doctest/doctest.h>

#include <stdexcept>
#include <vector>

#include "slam/street.hpp"

namespace chainslam {
namespace {

using test::keyframe_at;
using test::random_motion;

double difference(const SE3d& a, const SE3d& b) { return a.local(b).norm(); }

/// A random walk of odometry at 10 Hz from t = 0 s, with keyframes every second from t = 1 s to t = 4 s.
struct BentDrive {
  Trajectory odometry;
  std::vector<Keyframe> keyframes;

  explicit BentDrive(bool optimized = true) {
    Rng rng(3);
    SE3d pose = random_motion(rng, 5, 1);
    for (int i = 0; i <= 60; ++i) {
      odometry.times.push_back(Timestamp::from_nanoseconds(100'000'000LL * i));
      odometry.poses.push_back(pose);
      if (i >= 10 && i <= 40 && i % 10 == 0) {
        keyframes.push_back(keyframe_at(0, pose));
        keyframes.back().time = odometry.times.back();
        if (optimized) keyframes.back().T_map_body = random_motion(rng, 2, 0.3) * pose;
      }
      pose = pose * random_motion(rng, 0.5, 0.05);
    }
  }
};

TEST_SUITE("slam/corrected_trajectory") {
  TEST_CASE("keyframes have their optimized poses") {
    const BentDrive drive;
    const Trajectory corrected = corrected_trajectory(drive.odometry, drive.keyframes);
    REQUIRE(corrected.times == drive.odometry.times);
    for (std::size_t k = 0; k < drive.keyframes.size(); ++k)
      CHECK(difference(corrected.poses[10 * (k + 1)], drive.keyframes[k].T_map_body) < 1e-12);  // rounding
  }

  TEST_CASE("the path is continuous: a correction is spread evenly from keyframe to keyframe") {
    const BentDrive drive;
    const Trajectory corrected = corrected_trajectory(drive.odometry, drive.keyframes);
    for (std::size_t i = 10; i < 40; ++i) {
      const Keyframe& a = drive.keyframes[i / 10 - 1];
      const Keyframe& b = drive.keyframes[i / 10];
      const SE3d odometry_step = drive.odometry.poses[i].inverse() * drive.odometry.poses[i + 1];
      const SE3d step = corrected.poses[i].inverse() * corrected.poses[i + 1];
      const SE3d whole = (a.T_odom_body.inverse() * b.T_odom_body).inverse() * a.T_map_body.inverse() * b.T_map_body;
      // Steps turn against one another by the share spread so far: second order in a correction of about 2 m, 0.3 rad.
      const double share = whole.log().norm() / 10;
      CHECK(difference(odometry_step, step) < 2 * share + 1e-9);
    }
    // Just before a keyframe the path has all but reached its pose.
    Trajectory just_before;
    just_before.times = {drive.keyframes[2].time - Duration(1)};
    just_before.poses = {drive.keyframes[2].T_odom_body};
    CHECK(difference(corrected_trajectory(just_before, drive.keyframes).poses[0], drive.keyframes[2].T_map_body) <
          1e-8);  // a nanosecond's share of the correction
  }

  TEST_CASE("before the first and after the last keyframe the path moves rigidly with it") {
    const BentDrive drive;
    const Trajectory corrected = corrected_trajectory(drive.odometry, drive.keyframes);
    const auto rigid = [&](std::size_t i, const Keyframe& with) {
      return with.T_map_body * with.T_odom_body.inverse() * drive.odometry.poses[i];
    };
    for (std::size_t i = 0; i < 10; ++i) CHECK(difference(corrected.poses[i], rigid(i, drive.keyframes[0])) < 1e-12);
    for (std::size_t i = 41; i <= 60; ++i) CHECK(difference(corrected.poses[i], rigid(i, drive.keyframes[3])) < 1e-12);
  }

  TEST_CASE("where nothing was optimized, odometry stays as it is") {
    const BentDrive drive(false);
    const Trajectory corrected = corrected_trajectory(drive.odometry, drive.keyframes);
    for (std::size_t i = 0; i < corrected.size(); ++i)
      CHECK(difference(corrected.poses[i], drive.odometry.poses[i]) < 1e-12);  // rounding
    const Trajectory without = corrected_trajectory(drive.odometry, {});
    CHECK(without.poses == drive.odometry.poses);
  }

  TEST_CASE("one motion of the whole map moves the whole path by it") {
    BentDrive drive(false);
    const SE3d motion(SO3d::exp({0.1, -0.2, 1.5}), {3, -1, 0.5});
    for (Keyframe& keyframe : drive.keyframes) keyframe.T_map_body = motion * keyframe.T_odom_body;
    const Trajectory corrected = corrected_trajectory(drive.odometry, drive.keyframes);
    for (std::size_t i = 0; i < corrected.size(); ++i)
      CHECK(difference(corrected.poses[i], motion * drive.odometry.poses[i]) < 1e-12);
  }

  TEST_CASE("poses without times are refused, no poses are no trouble") {
    BentDrive drive;
    drive.odometry.times.clear();
    CHECK_THROWS_AS(static_cast<void>(corrected_trajectory(drive.odometry, drive.keyframes)), std::invalid_argument);
    CHECK(corrected_trajectory({}, drive.keyframes).empty());
  }
}

}  // namespace
}  // namespace chainslam
