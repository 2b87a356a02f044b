#pragma once

#include "chainslam/core/random.hpp"
#include "chainslam/lie/se2.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace generated {

/// Positions at 10 Hz for 30 s of who drives an arc from the origin, along x at first; orientations are not measured.
/// @param speed  m/s. @param turn  rad/s. @param sigma  of each coordinate's noise, metres.
inline chainslam::Trajectory arc_fixes(double speed, double turn, double sigma) {
  chainslam::Trajectory fixes;
  chainslam::Rng rng(1);
  for (int i = 0; i < 300; ++i) {
    const Eigen::Vector2d p = chainslam::SE2d::exp({speed * 0.1 * i, 0, turn * 0.1 * i}).translation();
    fixes.times.push_back(chainslam::Timestamp::from_seconds(0.1 * i));
    fixes.poses.emplace_back(chainslam::SO3d(), Eigen::Vector3d(rng.normal(p.x(), sigma), rng.normal(p.y(), sigma), 0));
  }
  return fixes;
}

}  // namespace generated
