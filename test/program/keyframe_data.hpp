#pragma once

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <numbers>
#include <string>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/io/pcd.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "program/run_program.hpp"

namespace chainslam::test {

/// Points of walls around a circle of 20 m, at random places of them.
inline std::vector<Eigen::Vector3f> walled_place(Rng& rng, int points_of_a_wall) {
  std::vector<Eigen::Vector3f> points;
  for (int wall = 0; wall < 60; ++wall) {
    const double bearing = rng.uniform(0, 2 * std::numbers::pi), distance = wall % 2 == 0 ? 12 : 29;
    const double yaw = rng.uniform(0, std::numbers::pi), length = rng.uniform(2, 6);
    for (int i = 0; i < points_of_a_wall; ++i) {
      const double along = rng.uniform(-length / 2, length / 2);
      points.emplace_back(static_cast<float>(distance * std::cos(bearing) + along * std::cos(yaw)),
                          static_cast<float>(distance * std::sin(bearing) + along * std::sin(yaw)),
                          static_cast<float>(rng.uniform(-1, 3)));
    }
  }
  return points;
}

/// Writes a data set of keyframes with recorded odometry: one and a third rounds of the circle, with odometry that
/// drifts, so that loops close. Mapping it takes the back end alone. @param gnss  whether each keyframe has a fix.
/// @param spacing  of the keyframes in time, seconds.
/// @param place_seed  another one has other walls.
inline void write_keyframes(const fs::path& folder, int count, bool gnss = false, std::uint64_t seed = 5,
                            int points_of_a_wall = 250, double spacing = 1.5, std::uint64_t place_seed = 1) {
  fs::create_directories(folder / "Scans");
  Rng rng(place_seed);
  const std::vector<Eigen::Vector3f> place = walled_place(rng, points_of_a_wall);
  Rng drift(seed);
  Trajectory odometry;
  SE3d last, T_odom_body;
  std::string times, fixes;
  for (int i = 0; i < count; ++i) {
    const double angle = i * 8.0 / 3 * std::numbers::pi / std::max(count, 36);
    const SE3d T_map_body(SO3d::exp({0, 0, angle + std::numbers::pi / 2}),
                          {20 * std::cos(angle), 20 * std::sin(angle), 0});
    if (i > 0)
      T_odom_body = T_odom_body * (last.inverse() * T_map_body) *
                    SE3d(SO3d::exp({0, 0, drift.normal(0, 0.002)}), {drift.normal(0, 0.02), 0, 0});
    last = T_map_body;
    odometry.poses.push_back(T_odom_body);
    PointCloud<float> near;
    for (const Eigen::Vector3f& p : transformed(place, T_map_body.inverse()).positions)
      if (p.norm() < 18) near.positions.push_back(p);
    char text[128];
    std::snprintf(text, sizeof text, "%06d.pcd", i);
    write_pcd(folder / "Scans" / text, near);
    std::snprintf(text, sizeof text, "%.3f\n", 100 + spacing * i);
    times += text;
    std::snprintf(text, sizeof text, "%.9f %.9f 10 0.5\n", 48 + T_map_body.translation().y() / 111'000,
                  9 + T_map_body.translation().x() / 74'000);
    fixes += text;
  }
  write_kitti_poses(folder / "odom_poses.txt", odometry);
  write_text(folder / "times.txt", times);
  if (gnss) write_text(folder / "gnss.txt", fixes);
}

}  // namespace chainslam::test
