#pragma once

#include <cmath>
#include <limits>
#include <vector>

#include "chainslam/trajectory/association.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam::test {

/// A winding path through space with turning poses, `n` poses about 0.9 m apart.
inline Trajectory winding(int n) {
  Trajectory path;
  for (int i = 0; i < n; ++i) {
    const double s = 0.1 * i;
    path.times.push_back(Timestamp::from_seconds(s));
    path.poses.push_back(SE3d(SO3d::exp({0.2 * std::sin(s), 0.1 * std::cos(2 * s), s}),
                              {8 * std::cos(s), 8 * std::sin(1.1 * s), std::sin(0.7 * s)}));
  }
  return path;
}

/// The path as seen from a frame that is turned, moved and scaled.
inline Trajectory seen_from(const SO3d& rotation, const Eigen::Vector3d& translation, double scale, Trajectory path) {
  for (SE3d& pose : path.poses)
    pose = SE3d(rotation * pose.rotation(), rotation * (scale * pose.translation()) + translation);
  return path;
}

inline Trajectory with_nan(Trajectory path) {
  path.poses.back() = SE3d(SO3d(), {0, 0, std::numeric_limits<double>::quiet_NaN()});
  return path;
}

}  // namespace chainslam::test
