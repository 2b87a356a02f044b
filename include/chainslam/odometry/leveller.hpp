#pragma once

#include <Eigen/Core>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/lie/so3.hpp"
#include "chainslam/odometry/inertial_state.hpp"

namespace chainslam {

/// Keeps odometry level over a local map that is not.
///
/// Each scan is held to the map of those before, and the slightest error of the sensor, the same in every scan, makes
/// the map as a whole turn out of level: no scan can tell. Errors of elevation, the same all around, bend it like a
/// bowl: up leans with the way, by a degree in 100 m with a sensor that sees 25 m and is 0.2 degrees off. Gravity can
/// tell: in a filter that lives in the map's frame its direction moves. The filter knows apart how far it has moved
/// (`creep`) and what was unknown of it at the start; by the former the map is turned back about the body, so that
/// poses turn smoothly and positions never jump.
class Leveller {
 public:
  /// @param x  the state after an update.
  void follow(const InertialState& x) {
    const Eigen::Vector3d& up = x.get<Inertial::up>().direction();
    Eigen::Vector3d up_at_start = up;
    const Eigen::Vector2d creep = x.get<Inertial::creep>().value();
    for (int i = 0; i < 2; ++i) up_at_start[i] -= creep[i];
    const SO3d level = SO3d::between(up, up_at_start);
    const Eigen::Vector3d& position = x.get<Inertial::position>().value();
    T_odom_map_ = SE3d(level, difference_of(T_odom_map_ * position, level * position));
  }

  /// From the frame of map and filter.
  [[nodiscard]] const SE3d& T_odom_map() const { return T_odom_map_; }

 private:
  SE3d T_odom_map_;
};

}  // namespace chainslam
