#pragma once

#include <Eigen/Core>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/lie/so3.hpp"
#include "chainslam/odometry/imu_process.hpp"

namespace chainslam::detail {

/// Keeps odometry gravity-aligned over a local map that slowly tilts.
///
/// Each scan is registered to the map of the previous ones, and a small systematic sensor error tilts the map as a
/// whole, which no scan observes. Elevation errors that are equal in all directions curve it like a bowl: `up` tilts
/// with the distance travelled, by a degree in 100 m for a sensor with 25 m range and an error of 0.2 degrees. Gravity
/// makes the tilt observable: its direction moves in a filter that is expressed in the map frame. The filter estimates
/// separately how far it has moved (`tilt`) and its uncertainty at the start; the former is used to rotate the map
/// back about the body, so that poses rotate smoothly and positions never jump.
class TiltCorrection {
 public:
  /// @param x  the state after an update.
  void follow(const InertialState& x) {
    const Eigen::Vector3d& up = x.get<Inertial::up>().direction();
    Eigen::Vector3d up_at_start = up;
    const Eigen::Vector2d tilt = x.get<Inertial::tilt>().value();
    for (int i = 0; i < 2; ++i) up_at_start[i] -= tilt[i];
    const SO3d level = SO3d::between(up, up_at_start);
    const Eigen::Vector3d& position = x.get<Inertial::position>().value();
    T_odom_map_ = SE3d(level, difference_of(T_odom_map_ * position, level * position));
  }

  /// From the frame of map and filter.
  [[nodiscard]] const SE3d& T_odom_map() const { return T_odom_map_; }

 private:
  SE3d T_odom_map_;
};

}  // namespace chainslam::detail
