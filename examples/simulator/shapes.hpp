#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

namespace chainslam::simulator {

/// What a surface is made of: it decides how much light comes back.
enum class Material : std::uint8_t { road, pavement, lawn, wall, glass, car, bark, foliage, metal, wood };

/// Whether a thing is there every day, on some days only, or not even for the length of a drive.
enum class Presence : std::uint8_t { lasting, changing, moving };

/// A half-line, world frame, metres.
struct Ray {
  Eigen::Vector3f origin;
  Eigen::Vector3f direction;  ///< unit length
  float max_distance;         ///< metres
};

/// "No hit".
constexpr float infinite_distance = std::numeric_limits<float>::infinity();

/// An axis-aligned box, metres.
struct Bounds {
  Eigen::Vector3f low;
  Eigen::Vector3f high;
};

/// A solid box of any orientation.
struct Box {
  Eigen::Vector3f center;
  Eigen::Matrix3f R_box_world;  ///< its rows are the box's axes
  Eigen::Vector3f half_extents;
  Material material;
  Presence presence = Presence::lasting;
};

/// A solid upright cylinder with flat ends.
struct Cylinder {
  Eigen::Vector3f base;  ///< centre of the lower end
  float radius;
  float height;
  Material material;
  Presence presence = Presence::lasting;
};

/// A solid ellipsoid whose axes are those of the world.
struct Ellipsoid {
  Eigen::Vector3f center;
  Eigen::Vector3f radii;
  Material material;
  Presence presence = Presence::lasting;
};

namespace detail {

/// A ray's stay in a convex solid: [enter, leave], empty if enter > leave.
struct Span {
  float enter = -infinite_distance;
  float leave = infinite_distance;

  /// Cuts the stay to where |position + t * rate| <= half.
  void clip_to_slab(float position, float rate, float half) {
    if (rate == 0.0F) {
      if (std::abs(position) > half) enter = infinite_distance;
      return;
    }
    const float inverse = 1.0F / rate;
    const float middle = -position * inverse;
    const float reach = half * std::abs(inverse);
    enter = std::max(enter, middle - reach);
    leave = std::min(leave, middle + reach);
  }

  /// Cuts the stay to where a t^2 + 2 b t + c <= 0, a >= 0.
  void clip_to_quadric(float a, float b, float c) {
    if (a <= 0.0F) {
      if (c > 0.0F) enter = infinite_distance;
      return;
    }
    const float discriminant = b * b - a * c;
    if (discriminant < 0.0F) {
      enter = infinite_distance;
      return;
    }
    const float root = std::sqrt(discriminant);
    enter = std::max(enter, (-b - root) / a);
    leave = std::min(leave, (-b + root) / a);
  }

  /// Where the surface is met from outside; a ray that starts inside a solid does not see it.
  [[nodiscard]] float first_hit() const { return enter <= leave && enter > 0.0F ? enter : infinite_distance; }
};

}  // namespace detail

/// Distance along the ray to the surface met first, or `infinite_distance`. The ray's maximum does not count here.
[[nodiscard]] inline float distance_to(const Box& box, const Ray& ray) {
  const Eigen::Vector3f position = box.R_box_world * (ray.origin - box.center);
  const Eigen::Vector3f rate = box.R_box_world * ray.direction;
  detail::Span span;
  for (int axis = 0; axis < 3; ++axis) span.clip_to_slab(position[axis], rate[axis], box.half_extents[axis]);
  return span.first_hit();
}

[[nodiscard]] inline float distance_to(const Cylinder& cylinder, const Ray& ray) {
  const Eigen::Vector3f position = ray.origin - cylinder.base;
  // From the point of closest approach, so that c does not lose its digits to the square of the distance.
  const Eigen::Vector2f direction = ray.direction.head<2>();
  const float a = direction.squaredNorm();
  const float nearest = a > 0.0F ? -position.head<2>().dot(direction) / a : 0.0F;
  const Eigen::Vector2f offset = position.head<2>() + nearest * direction;
  detail::Span span;
  span.clip_to_quadric(a, 0.0F, offset.squaredNorm() - cylinder.radius * cylinder.radius);
  span.enter += nearest;
  span.leave += nearest;
  const float half = 0.5F * cylinder.height;
  span.clip_to_slab(position.z() - half, ray.direction.z(), half);
  return span.first_hit();
}

[[nodiscard]] inline float distance_to(const Ellipsoid& ellipsoid, const Ray& ray) {
  const Eigen::Vector3f position = (ray.origin - ellipsoid.center).cwiseQuotient(ellipsoid.radii);
  const Eigen::Vector3f direction = ray.direction.cwiseQuotient(ellipsoid.radii);
  const float a = direction.squaredNorm();
  const float nearest = -position.dot(direction) / a;
  const Eigen::Vector3f offset = position + nearest * direction;
  detail::Span span;
  span.clip_to_quadric(a, 0.0F, offset.squaredNorm() - 1.0F);
  span.enter += nearest;
  return span.enter > 0.0F ? span.enter : infinite_distance;
}

/// Outward unit normal where the ray enters the solid: of the face that is nearest among those that face the ray.
[[nodiscard]] inline Eigen::Vector3f normal_at(const Box& box, const Ray& ray, float distance) {
  const Eigen::Vector3f local = box.R_box_world * (ray.origin + distance * ray.direction - box.center);
  const Eigen::Vector3f rate = box.R_box_world * ray.direction;
  int face = 0;
  float nearest = infinite_distance;
  for (int axis = 0; axis < 3; ++axis) {
    if (rate[axis] == 0.0F) continue;
    const float gap = std::abs(local[axis] + std::copysign(box.half_extents[axis], rate[axis]));
    if (gap < nearest) nearest = gap, face = axis;
  }
  return box.R_box_world.row(face).transpose() * std::copysign(1.0F, -rate[face]);
}

[[nodiscard]] inline Eigen::Vector3f normal_at(const Cylinder& cylinder, const Ray& ray, float distance) {
  const Eigen::Vector3f local = ray.origin + distance * ray.direction - cylinder.base;
  const float to_side = std::abs(cylinder.radius - local.head<2>().norm());
  const bool upwards = ray.direction.z() > 0.0F;
  const float to_end = std::abs(upwards ? local.z() : cylinder.height - local.z());
  const bool faces_side = local.head<2>().dot(ray.direction.head<2>()) < 0.0F;
  if (!faces_side || (to_end < to_side && ray.direction.z() != 0.0F))
    return Eigen::Vector3f::UnitZ() * (upwards ? -1.0F : 1.0F);
  return Eigen::Vector3f(local.x(), local.y(), 0.0F).normalized();
}

[[nodiscard]] inline Eigen::Vector3f normal_at(const Ellipsoid& ellipsoid, const Ray& ray, float distance) {
  const Eigen::Vector3f local = ray.origin + distance * ray.direction - ellipsoid.center;
  return local.cwiseQuotient(ellipsoid.radii.cwiseAbs2()).normalized();
}

[[nodiscard]] inline Bounds bounds(const Box& box) {
  const Eigen::Vector3f reach = box.R_box_world.cwiseAbs().transpose() * box.half_extents;
  return {box.center - reach, box.center + reach};
}

[[nodiscard]] inline Bounds bounds(const Cylinder& cylinder) {
  const Eigen::Vector3f side(cylinder.radius, cylinder.radius, 0.0F);
  return {cylinder.base - side, cylinder.base + side + cylinder.height * Eigen::Vector3f::UnitZ()};
}

[[nodiscard]] inline Bounds bounds(const Ellipsoid& ellipsoid) {
  return {ellipsoid.center - ellipsoid.radii, ellipsoid.center + ellipsoid.radii};
}

}  // namespace chainslam::simulator
