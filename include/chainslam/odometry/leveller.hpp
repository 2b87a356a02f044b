#pragma once

#include <Eigen/Core>

#include "chainslam/lie/s2.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/lie/so3.hpp"
#include "chainslam/odometry/inertial_state.hpp"

namespace chainslam {

/// Keeps odometry level over a local map that is not.
///
/// Each scan is held to the map of those before, and the slightest error of the sensor, the same in every scan, makes
/// the map as a whole turn out of level: no scan can tell. Gravity can: in a filter that lives in the map's frame its
/// direction moves. As far as that is put down to the map, and not to what was unknown of the direction at the start,
/// the map is turned back about the body, so that poses turn smoothly and positions never jump.
class Leveller {
 public:
  Leveller() = default;
  /// @param walk     radians per sqrt(s), by which the direction is expected to move in the map; 0: never.
  /// @param unknown  radians, deviation of the direction at the start.
  Leveller(double walk, double unknown) : walk_(walk), unknown_(unknown) {}

  /// @param up_before  the direction before an update. @param x  the state after it. @param interval  seconds passed.
  void follow(const S2d& up_before, const InertialState& x, double interval) {
    if (walk_ == 0) return;
    moved_ += interval * walk_ * walk_;
    const double share = moved_ / (moved_ + unknown_ * unknown_);
    const SO3d& R = T_odom_map_.rotation();
    const SO3d back = SO3d::between(R * x.get<Inertial::up>().direction(), R * up_before.direction());
    const SO3d level = SO3d::exp(share * back.log()) * R;
    const Eigen::Vector3d& position = x.get<Inertial::position>().value();
    T_odom_map_ = SE3d(level, T_odom_map_ * position - level * position);
  }

  /// From the frame of map and filter.
  [[nodiscard]] const SE3d& T_odom_map() const { return T_odom_map_; }

 private:
  SE3d T_odom_map_;
  double walk_ = 0, unknown_ = 0;
  double moved_ = 0;  ///< rad^2, variance of the direction that is the map's by now
};

}  // namespace chainslam
