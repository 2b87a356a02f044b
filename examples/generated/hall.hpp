#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/lie/se3.hpp"

/// Data for the example programs where the user gives none: what a LiDAR sees in a hall.
namespace generated {

using namespace chainslam;

struct Box {
  Eigen::Vector3d low, high;  ///< metres
};

/// A hall of 30 x 20 x 6 m, seen from inside, and what stands in it, seen from outside: no two places look alike.
inline const Box hall{{-15, -10, 0}, {15, 10, 6}};
inline const std::array<Box, 7> furniture{{{{-11, 4, 0}, {-8, 6, 4}},
                                           {{9, 5.5, 0}, {12, 9, 2}},
                                           {{-13, -8, 0}, {-12, -3, 3}},
                                           {{3, -9, 0}, {5, -8, 6}},
                                           {{-2, 7.5, 0}, {2, 8.5, 1.5}},
                                           {{11, -7, 0}, {13, -5, 5}},
                                           {{-0.5, -0.5, 0}, {0.5, 0.5, 2.5}}}};

/// Where a ray enters and leaves a box, in lengths of `direction`.
inline std::array<double, 2> crossing(const Box& box, const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) {
  std::array<double, 2> span{-std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity()};
  for (int axis = 0; axis < 3; ++axis) {
    const double a = (box.low[axis] - origin[axis]) / direction[axis];
    const double b = (box.high[axis] - origin[axis]) / direction[axis];
    span = {std::max(span[0], std::min(a, b)), std::min(span[1], std::max(a, b))};
  }
  return span;
}

/// One sweep of a LiDAR of 32 rings over `period` seconds, with 1 cm of noise.
/// @param pose_at  T_hall_lidar by the seconds since the sweep began.
template <class PoseAt>
PointCloud<float> sweep(const PoseAt& pose_at, double period, Rng& rng) {
  constexpr int columns = 360, rings = 32;
  PointCloud<float> cloud;
  for (int column = 0; column < columns; ++column) {
    const double time = period * column / columns, azimuth = 2 * std::numbers::pi * column / columns;
    const SE3d T_hall_lidar = pose_at(time);
    for (int ring = 0; ring < rings; ++ring) {
      const double elevation = -0.45 + 0.9 * ring / (rings - 1);
      const Eigen::Vector3d ray(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
                                std::sin(elevation));
      const Eigen::Vector3d origin = T_hall_lidar.translation(), direction = T_hall_lidar.rotation() * ray;
      double range = crossing(hall, origin, direction)[1];
      for (const Box& box : furniture) {
        const auto [enters, leaves] = crossing(box, origin, direction);
        if (enters < leaves && enters > 0) range = std::min(range, enters);
      }
      cloud.positions.push_back(((range + 0.01 * rng.normal()) * ray).cast<float>());
      if (period > 0) cloud.time_offsets.push_back(static_cast<float>(time));
    }
  }
  return cloud;
}

/// What is seen from one place.
inline PointCloud<float> scan(const SE3d& T_hall_lidar, Rng& rng) {
  return sweep([&](double) { return T_hall_lidar; }, 0, rng);
}

/// A pose of a sensor that stands upright, 1.5 m above the floor.
inline SE3d upright(double x, double y, double yaw) { return SE3d(SO3d::exp({0, 0, yaw}), {x, y, 1.5}); }

}  // namespace generated
