#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>

#include "simulator/world.hpp"

namespace chainslam::simulator::test {

/// Casts rays by testing every shape and every triangle, in double, by other formulas than the simulator's.
///
/// `grow` makes all shapes thicker and the ground higher by as much, metres: what the exact answer must lie between.
class BruteForce {
 public:
  BruteForce(const World& world, double grow) : world_(world), grow_(grow) {}

  /// Distance to the first surface met from outside, or infinity.
  [[nodiscard]] double cast(const Ray& ray) const {
    const Eigen::Vector3d o = ray.origin.cast<double>();
    const Eigen::Vector3d d = ray.direction.cast<double>();
    double nearest = std::numeric_limits<double>::infinity();
    const auto meet = [&](double t) { nearest = t > 0.0 ? std::min(nearest, t) : nearest; };
    for (const Box& box : world_.boxes) meet(box_distance(box, o, d));
    for (const Cylinder& cylinder : world_.cylinders) meet(cylinder_distance(cylinder, o, d));
    for (const Ellipsoid& ellipsoid : world_.ellipsoids) meet(ellipsoid_distance(ellipsoid, o, d));
    const HeightField& ground = world_.ground;
    for (Index row = 0; row + 1 < ground.rows; ++row)
      for (Index column = 0; column + 1 < ground.columns; ++column) {
        const Eigen::Vector3d p00 = corner(column, row), p10 = corner(column + 1, row);
        const Eigen::Vector3d p01 = corner(column, row + 1), p11 = corner(column + 1, row + 1);
        meet(triangle_distance(p00, p10, p11, o, d));
        meet(triangle_distance(p00, p11, p01, o, d));
      }
    return nearest <= static_cast<double>(ray.max_distance) ? nearest : std::numeric_limits<double>::infinity();
  }

 private:
  static constexpr double miss = -1.0;

  /// Each face as a plane; the nearest crossing of one from outside that lies in the box.
  double box_distance(const Box& box, const Eigen::Vector3d& o, const Eigen::Vector3d& d) const {
    const Eigen::Matrix3d R = box.R_box_world.cast<double>();
    const Eigen::Vector3d half = box.half_extents.cast<double>().array() + grow_;
    const Eigen::Vector3d p = R * (o - box.center.cast<double>());
    const Eigen::Vector3d v = R * d;
    for (int axis = 0; axis < 3; ++axis)
      for (const double side : {-1.0, 1.0}) {
        if (v[axis] * side >= 0.0) continue;  // leaves through this face, or runs along it
        const double t = (side * half[axis] - p[axis]) / v[axis];
        Eigen::Vector3d at = p + t * v;
        at[axis] = 0.0;
        if (t > 0.0 && (at.cwiseAbs() - half).maxCoeff() <= 0.0) return t;
      }
    return miss;
  }

  double cylinder_distance(const Cylinder& cylinder, const Eigen::Vector3d& o, const Eigen::Vector3d& d) const {
    const double radius = static_cast<double>(cylinder.radius) + grow_;
    const Eigen::Vector3d p = o - cylinder.base.cast<double>();
    const double bottom = -grow_;
    const double top = static_cast<double>(cylinder.height) + grow_;
    double nearest = std::numeric_limits<double>::infinity();
    const double a = d.head<2>().squaredNorm();
    const double b = p.head<2>().dot(d.head<2>());
    const double discriminant = b * b - a * (p.head<2>().squaredNorm() - radius * radius);
    if (a > 0.0 && discriminant >= 0.0) {
      const double t = (-b - std::sqrt(discriminant)) / a;
      const double z = p.z() + t * d.z();
      if (t > 0.0 && z >= bottom && z <= top) nearest = t;
    }
    for (const double z : {bottom, top}) {
      if ((z == bottom) != (d.z() > 0.0) || d.z() == 0.0) continue;
      const double t = (z - p.z()) / d.z();
      if (t > 0.0 && (p + t * d).head<2>().norm() <= radius) nearest = std::min(nearest, t);
    }
    return std::isfinite(nearest) ? nearest : miss;
  }

  double ellipsoid_distance(const Ellipsoid& ellipsoid, const Eigen::Vector3d& o, const Eigen::Vector3d& d) const {
    const Eigen::Vector3d radii = ellipsoid.radii.cast<double>().array() + grow_;
    const Eigen::Vector3d p = (o - ellipsoid.center.cast<double>()).cwiseQuotient(radii);
    const Eigen::Vector3d v = d.cwiseQuotient(radii);
    const double b = p.dot(v);
    const double discriminant = b * b - v.squaredNorm() * (p.squaredNorm() - 1.0);
    return discriminant >= 0.0 ? (-b - std::sqrt(discriminant)) / v.squaredNorm() : miss;
  }

  [[nodiscard]] Eigen::Vector3d corner(Index column, Index row) const {
    const HeightField& ground = world_.ground;
    const Eigen::Vector2f at =
        ground.origin + ground.spacing * Eigen::Vector2f(static_cast<float>(column), static_cast<float>(row));
    return {static_cast<double>(at.x()), static_cast<double>(at.y()),
            static_cast<double>(ground.heights[ground.at(column, row)]) + grow_};
  }

  /// Moeller and Trumbore 1997, from above only; edges count for both neighbours.
  static double triangle_distance(const Eigen::Vector3d& a, const Eigen::Vector3d& b, const Eigen::Vector3d& c,
                                  const Eigen::Vector3d& o, const Eigen::Vector3d& d) {
    constexpr double edge = 1e-9;
    const Eigen::Vector3d ab = b - a;
    const Eigen::Vector3d ac = c - a;
    const Eigen::Vector3d normal = ab.cross(ac);
    if (normal.dot(d) >= 0.0) return miss;
    const Eigen::Vector3d p = d.cross(ac);
    const double scale = 1.0 / ab.dot(p);
    const double u = scale * (o - a).dot(p);
    const Eigen::Vector3d q = (o - a).cross(ab);
    const double v = scale * d.dot(q);
    if (u < -edge || v < -edge || u + v > 1.0 + edge) return miss;
    return scale * ac.dot(q);
  }

  const World& world_;
  double grow_;
};

}  // namespace chainslam::simulator::test
