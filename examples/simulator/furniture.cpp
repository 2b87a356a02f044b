#include "simulator/furniture.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace chainslam::simulator {

namespace {

/// From the trunk, at `clear`, to where a blob of leaves would be.
void add_limb(World& world, const Place& place, double angle, double off, double clear, double height) {
  const Eigen::Vector3d along(off * std::cos(angle), off * std::sin(angle), height - 0.8 * clear);
  const Eigen::Matrix3d turn =
      Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitX(), along.normalized()).toRotationMatrix();
  add_box(world, place.moved({0.0, 0.0, 0.8 * clear}, turn), {0.0, -0.03, -0.03}, {along.norm(), 0.03, 0.03},
          Material::bark);
}

}  // namespace

void add_car(World& world, const Place& place, Rng rng) {
  const bool van = rng.uniform() < 0.15;
  const double half_length = 0.5 * (van ? rng.uniform(4.6, 5.4) : rng.uniform(3.6, 4.8));
  const double half_width = 0.5 * rng.uniform(1.65, 1.9);
  const double waist = van ? 1.1 : rng.uniform(0.85, 1.0);
  const double roof = van ? rng.uniform(1.9, 2.3) : rng.uniform(1.4, 1.6);
  const double hood = half_length - (van ? 0.9 : rng.uniform(1.0, 1.3));
  const double tail = half_length - (van ? 0.05 : rng.uniform(0.2, 0.9));
  add_box(world, place, {-half_length, -half_width, 0.25}, {half_length, half_width, waist}, Material::car);
  add_box(world, place, {-tail, -half_width + 0.1, waist}, {hood, half_width - 0.1, roof - 0.06}, Material::glass);
  add_box(world, place, {-tail, -half_width + 0.1, roof - 0.06}, {hood - 0.3, half_width - 0.1, roof}, Material::car);
  for (const double x : {-0.6 * half_length, 0.6 * half_length})
    for (const double y : {-half_width + 0.1, half_width - 0.1})
      add_box(world, place, {x - 0.3, y - 0.1, 0.0}, {x + 0.3, y + 0.1, 0.58}, Material::road);
}

void add_tree(World& world, const Place& place, double size, Rng rng, bool bare) {
  const double clear = size * rng.uniform(2.4, 3.4);
  const double spread = size * rng.uniform(1.0, 1.7);
  const double crown = size * rng.uniform(2.5, 4.0);
  add_cylinder(world, place, {0.0, 0.0, -0.3}, size * rng.uniform(0.1, 0.22), clear + 0.5 * crown, Material::bark);
  const int blobs = 5 + rng.uniform_index(5);
  for (int i = 0; i < blobs; ++i) {
    const double angle = rng.uniform(0.0, 2.0 * std::numbers::pi);
    const double off = spread * rng.uniform(0.1, 0.75);
    Eigen::Vector3d radii;
    for (int axis = 0; axis < 2; ++axis) radii[axis] = spread * rng.uniform(0.4, 0.8);
    radii.z() = crown * rng.uniform(0.18, 0.32);
    const double height = clear + rng.uniform(0.2, 0.85) * crown;
    if (bare)
      add_limb(world, place, angle, off, clear, height);
    else
      add_ellipsoid(world, place, {off * std::cos(angle), off * std::sin(angle), height}, radii, Material::foliage);
  }
}

void add_heap(World& world, const Place& place, Rng rng) {
  const double width = rng.uniform(0.4, 0.9);
  add_ellipsoid(world, place, {0.0, 0.0, 0.0}, {rng.uniform(0.7, 1.0) * width, width, rng.uniform(0.3, 0.8)},
                Material::wall);
}

void add_scaffold(World& world, const Place& place, double half, double height) {
  constexpr double bay = 2.5;
  constexpr double lift = 2.0;
  const int bays = std::max(1, static_cast<int>(2.0 * half / bay));
  for (int i = 0; i <= bays; ++i)
    for (const double y : {-1.2, -0.4})
      add_cylinder(world, place, {-half + 2.0 * half * i / bays, y, -0.3}, 0.03, height + 1.3, Material::metal);
  for (double z = lift; z < height; z += lift) {
    add_box(world, place, {-half, -1.2, z - 0.05}, {half, -0.4, z}, Material::wood);
    add_box(world, place, {-half, -1.22, z + 0.95}, {half, -1.18, z + 1.0}, Material::metal);
  }
}

void add_lamp(World& world, const Place& place, Rng rng) {
  const double height = rng.uniform(5.0, 7.0);
  add_cylinder(world, place, {0.0, 0.0, -0.3}, rng.uniform(0.06, 0.1), height + 0.3, Material::metal);
  add_cylinder(world, place, {0.0, 0.0, -0.3}, rng.uniform(0.11, 0.15), 1.2, Material::metal);
  add_box(world, place, {-0.05, 0.0, height - 0.1}, {0.05, rng.uniform(0.9, 1.6), height}, Material::metal);
}

void add_sign(World& world, const Place& place, Rng rng) {
  const double height = rng.uniform(2.3, 2.9);
  const double half = rng.uniform(0.22, 0.4);
  add_cylinder(world, place, {0.0, 0.0, -0.3}, 0.035, height + 0.3, Material::metal);
  const Place turned = place.moved({0.0, 0.0, 0.0}, yawed(rng.uniform(-0.2, 0.2)));
  add_box(world, turned, {-0.06, -half, height - 2.0 * half}, {-0.04, half, height}, Material::metal);
}

void add_bollards(World& world, const Place& place, Rng rng) {
  const int count = 3 + rng.uniform_index(3);
  const double radius = rng.uniform(0.05, 0.1);
  for (int i = 0; i < count; ++i) add_cylinder(world, place, {1.4 * i, 0.0, -0.3}, radius, 1.3, Material::metal);
}

void add_street_box(World& world, const Place& place, Rng rng) {
  const double half_length = rng.uniform(0.25, 0.9);
  const double half_width = rng.uniform(0.18, 0.35);
  add_box(world, place, {-half_length, -half_width, -0.3}, {half_length, half_width, rng.uniform(0.45, 1.5)},
          Material::metal);
}

void add_shelter(World& world, const Place& place, Rng rng) {
  const double height = rng.uniform(2.3, 2.6);
  add_box(world, place, {-1.8, -0.7, height - 0.12}, {1.8, 0.7, height}, Material::metal);
  add_box(world, place, {-1.8, -0.7, 0.1}, {1.8, -0.66, height}, Material::glass);
  add_box(world, place, {-1.8, -0.7, 0.1}, {-1.76, 0.3, height}, Material::glass);
  add_box(world, place, {-1.2, -0.6, 0.4}, {1.2, -0.25, 0.5}, Material::wood);
  for (const double x : {-1.8, 1.8}) add_cylinder(world, place, {x, 0.6, -0.3}, 0.05, height + 0.2, Material::metal);
}

void add_fence(World& world, const Place& place, double length, FenceKind kind, Rng rng) {
  switch (kind) {
    case FenceKind::wall:
      add_box(world, place, {0.0, -0.12, -0.5}, {length, 0.12, rng.uniform(0.9, 1.1)}, Material::wall);
      break;
    case FenceKind::hedge: {
      const double half_width = rng.uniform(0.25, 0.45);
      add_box(world, place, {0.0, -half_width, -0.3}, {length, half_width, rng.uniform(1.1, 1.6)}, Material::foliage);
      break;
    }
    case FenceKind::pickets:
      add_box(world, place, {-0.05, -0.05, -0.4}, {0.05, 0.05, 1.25}, Material::wood);
      add_box(world, place, {0.0, -0.02, 0.3}, {length, 0.02, 0.42}, Material::wood);
      add_box(world, place, {0.0, -0.02, 0.85}, {length, 0.02, 0.97}, Material::wood);
      break;
  }
}

}  // namespace chainslam::simulator
