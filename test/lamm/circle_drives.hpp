#pragma once

#include <cmath>
#include <cstddef>
#include <numbers>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/lie/se3.hpp"
#include "drive.hpp"
#include "loop_search.hpp"

namespace chainslam::test {

using lamm::Drive;
using lamm::Loop;

/// A drive around a circle of 50 m, a frame every 0.3 m, a scan every ten; odometry as good as `noise` a frame.
inline Drive round_trip(Rng& rng, double noise, double from_angle, const SE3d& T_odom_map, std::vector<SE3d>& truth) {
  Drive drive;
  SE3d last, pose = T_odom_map;
  for (int i = 0; i < 1000; ++i) {
    const double angle = from_angle + 0.3 * i / 50;
    const SE3d T(SO3d::exp({0, 0, angle + std::numbers::pi / 2}), {50 * std::cos(angle), 50 * std::sin(angle), 0});
    Vector6d error;
    for (double& entry : error) entry = rng.normal(0, noise);
    pose = i == 0 ? T_odom_map * T : pose * (last.inverse() * T) * SE3d::exp(error);
    last = T;
    drive.odometry.poses.push_back(pose);
    drive.odometry.times.push_back(Timestamp(seconds(0.1 * i)));
    truth.push_back(T);
    if (i % 10 == 0) drive.scans.push_back({.frame = i});
  }
  return drive;
}

inline Loop true_loop(Index source, Index source_frame, Index target, Index target_frame,
                      const std::vector<std::vector<SE3d>>& truths) {
  const auto pose = [&](Index drive, Index frame) {
    return truths[static_cast<std::size_t>(drive)][static_cast<std::size_t>(frame)];
  };
  return {.source = source,
          .target = target,
          .source_frame = source_frame,
          .target_frame = target_frame,
          .T_target_source = pose(target, target_frame).inverse() * pose(source, source_frame),
          .overlap = 0.8,
          .kept = true};
}

struct TwoDrives {
  std::vector<Drive> drives;
  std::vector<std::vector<SE3d>> truths{2};
};

/// Two drives around one circle, each in a frame of its own.
inline TwoDrives two_drives(Rng& rng, double noise) {
  TwoDrives two;
  two.drives.push_back(round_trip(rng, noise, 0, SE3d(), two.truths[0]));
  const SE3d T_odom_map(SO3d::exp({0, 0, rng.uniform(-3, 3)}), {rng.uniform(-80, 80), rng.uniform(-80, 80), 3});
  two.drives.push_back(round_trip(rng, noise, rng.uniform(0, 1), T_odom_map, two.truths[1]));
  return two;
}

inline std::vector<Loop> loops_between(const TwoDrives& two, int count) {
  std::vector<Loop> loops;
  for (int i = 0; i < count; ++i) loops.push_back(true_loop(1, 900 * i / count, 0, 900 * i / count, two.truths));
  return loops;
}

}  // namespace chainslam::test
