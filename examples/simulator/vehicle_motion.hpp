#pragma once

#include <Eigen/Core>

#include "chainslam/lie/se3.hpp"

namespace chainslam::simulator {

/// The truth at one time. The world is the map frame: z up, metres.
struct Motion {
  SE3d T_map_body;
  Eigen::Vector3d velocity_map;      ///< m/s
  Eigen::Vector3d acceleration_map;  ///< m/s^2, without gravity
  Eigen::Vector3d rate_body;         ///< rad/s
};

/// A motion that sensors can be carried along: at least twice continuously differentiable.
class VehicleMotion {
 public:
  virtual ~VehicleMotion() = default;

  [[nodiscard]] virtual double duration() const = 0;  ///< seconds
  /// @param time  seconds from the start.
  [[nodiscard]] virtual Motion motion(double time) const = 0;
  [[nodiscard]] SE3d pose(double time) const { return motion(time).T_map_body; }

 protected:
  VehicleMotion() = default;
  VehicleMotion(const VehicleMotion&) = default;
  VehicleMotion(VehicleMotion&&) = default;
  VehicleMotion& operator=(const VehicleMotion&) = default;
  VehicleMotion& operator=(VehicleMotion&&) = default;
};

}  // namespace chainslam::simulator
