#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam::test {

/// A rectangle: center + a * u + b * v with |a|, |b| <= 1; u and v at right angles.
struct Panel {
  Eigen::Vector3d center, u, v;
};

/// A world of rectangles, small enough to cast rays in closed form.
struct World {
  std::vector<Panel> panels;

  /// The six sides of an axis-aligned box.
  void add_box(const Eigen::Vector3d& center, const Eigen::Vector3d& half) {
    for (int axis = 0; axis < 3; ++axis) {
      const Eigen::Vector3d n = Eigen::Vector3d::Unit(axis) * half[axis];
      const int b = (axis + 1) % 3, c = (axis + 2) % 3;
      const Eigen::Vector3d u = Eigen::Vector3d::Unit(b) * half[b], v = Eigen::Vector3d::Unit(c) * half[c];
      panels.push_back({center + n, u, v});
      panels.push_back({center - n, u, v});
    }
  }

  /// What a plane through `point` cuts: rays in that plane meet no more.
  [[nodiscard]] World cut_by_plane(const Eigen::Vector3d& point, const Eigen::Vector3d& normal) const {
    constexpr double rounding = 1e-6;  // metres
    World cut;
    for (const Panel& panel : panels)
      if (std::abs(normal.dot(panel.center - point)) <=
          std::abs(normal.dot(panel.u)) + std::abs(normal.dot(panel.v)) + rounding)
        cut.panels.push_back(panel);
    return cut;
  }

  /// Distance to the first panel along a unit direction, or infinity.
  [[nodiscard]] double range(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) const {
    double nearest = std::numeric_limits<double>::infinity();
    for (const Panel& panel : panels) {
      const Eigen::Vector3d n = panel.u.cross(panel.v);
      const double slope = n.dot(direction);
      if (slope == 0) continue;
      const double range = n.dot(panel.center - origin) / slope;
      if (!(range > 0) || range >= nearest) continue;
      const Eigen::Vector3d hit = origin + range * direction - panel.center;
      if (std::abs(hit.dot(panel.u)) <= panel.u.squaredNorm() && std::abs(hit.dot(panel.v)) <= panel.v.squaredNorm())
        nearest = range;
    }
    return nearest;
  }
};

/// A hall of 40 x 30 x 6 m with pillars and crates at irregular places: all six directions are seen from everywhere.
inline World hall() {
  World world;
  world.add_box({5, 2, 2}, {20, 15, 3});
  world.add_box({10, 6, 1}, {0.5, 0.5, 2.9});
  world.add_box({-6, -5, 1}, {0.4, 0.6, 2.9});
  world.add_box({4, -8, -0.2}, {1.0, 1.5, 0.8});
  world.add_box({18, -3, 0.1}, {1.5, 0.7, 1.1});
  world.add_box({-9, 9, 0}, {0.7, 1.1, 1.0});
  return world;
}

/// A corridor along x without ends: nothing tells how far along it one is.
inline World corridor() {
  World world;
  world.panels = {{{0, 2, 0}, {500, 0, 0}, {0, 0, 3}},
                  {{0, -2, 0}, {500, 0, 0}, {0, 0, 3}},
                  {{0, 0, -1}, {500, 0, 0}, {0, 2, 0}},
                  {{0, 0, 2}, {500, 0, 0}, {0, 2, 0}}};
  return world;
}

/// A spinning LiDAR of 32 rings within +-30 degrees.
struct Spinner {
  int rings = 32;
  int columns = 360;
  double duration = 0.1;  ///< seconds a sweep
  double noise = 0.01;    ///< metres along the ray
  bool timed = true;  ///< with time offsets; else the pose of the end holds for all points and the scan is a snapshot

  /// @param pose  `SE3d pose(double t)`: T_world_lidar at `t` seconds.
  template <class Pose>
  [[nodiscard]] LidarScan sweep(const World& world, double begin, Pose&& pose, Rng& rng) const {
    LidarScan scan;
    scan.time = Timestamp::from_seconds(timed ? begin : begin + duration);
    scan.end = Timestamp::from_seconds(begin + duration);
    for (int column = 0; column < columns; ++column) {
      const double share = static_cast<double>(column) / columns;
      const double offset = timed ? duration * share : duration;
      const SE3d T_world_lidar = pose(begin + offset);
      const double azimuth = -2 * std::numbers::pi * share;
      const Eigen::Vector3d across =
          T_world_lidar.rotation() * Eigen::Vector3d(-std::sin(azimuth), std::cos(azimuth), 0);
      const World seen = world.cut_by_plane(T_world_lidar.translation(), across);
      for (int ring = 0; ring < rings; ++ring) {
        const double elevation = (ring + 0.5) / rings * std::numbers::pi / 3 - std::numbers::pi / 6;
        const Eigen::Vector3d ray(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
                                  std::sin(elevation));
        const double range = seen.range(T_world_lidar.translation(), T_world_lidar.rotation() * ray);
        if (range > 100) continue;
        scan.cloud.positions.push_back(((range + rng.normal(0, noise)) * ray).cast<float>());
        if (timed) scan.cloud.time_offsets.push_back(static_cast<float>(offset));
      }
    }
    return scan;
  }
};

}  // namespace chainslam::test
