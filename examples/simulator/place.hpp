#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>

#include "simulator/world.hpp"

namespace chainslam::simulator {

/// A frame in which a thing is put together: T_world_place.
struct Place {
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();  ///< R_world_place

  [[nodiscard]] Eigen::Vector3d at(const Eigen::Vector3d& local) const { return origin + rotation * local; }

  /// The same axes, moved by `local`, then turned by `turn` (R_place_new).
  [[nodiscard]] Place moved(const Eigen::Vector3d& local,
                            const Eigen::Matrix3d& turn = Eigen::Matrix3d::Identity()) const {
    return {at(local), rotation * turn};
  }
};

/// Rotation about z, radians.
[[nodiscard]] inline Eigen::Matrix3d yawed(double yaw) {
  return Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix();
}

/// An upright place whose x axis points along the horizontal `direction`.
[[nodiscard]] inline Place upright(const Eigen::Vector3d& origin, const Eigen::Vector2d& direction) {
  return {origin, yawed(std::atan2(direction.y(), direction.x()))};
}

/// Adds the box between two opposite corners, given in the place's frame.
inline void add_box(World& world, const Place& place, const Eigen::Vector3d& low, const Eigen::Vector3d& high,
                    Material material) {
  const Eigen::Vector3d center = 0.5 * (low + high);
  world.boxes.push_back({.center = place.at(center).cast<float>(),
                         .R_box_world = place.rotation.transpose().cast<float>(),
                         .half_extents = (0.5 * (high - low)).cast<float>(),
                         .material = material,
                         .presence = Presence::lasting});
}

/// Adds an upright cylinder whose lower end is centred at `base`, in the place's frame.
inline void add_cylinder(World& world, const Place& place, const Eigen::Vector3d& base, double radius, double height,
                         Material material) {
  world.cylinders.push_back({.base = place.at(base).cast<float>(),
                             .radius = static_cast<float>(radius),
                             .height = static_cast<float>(height),
                             .material = material,
                             .presence = Presence::lasting});
}

/// Adds an ellipsoid centred at `center`, in the place's frame; its axes are the world's.
inline void add_ellipsoid(World& world, const Place& place, const Eigen::Vector3d& center, const Eigen::Vector3d& radii,
                          Material material) {
  world.ellipsoids.push_back({.center = place.at(center).cast<float>(),
                              .radii = radii.cast<float>(),
                              .material = material,
                              .presence = Presence::lasting});
}

}  // namespace chainslam::simulator
