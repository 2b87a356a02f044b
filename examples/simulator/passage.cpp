#include "simulator/passage.hpp"

#include <algorithm>

namespace chainslam::simulator {

namespace {

constexpr double joint = 0.05;  // pieces reach into each other by this, metres

void add_doors(World& world, const Place& place, double half, Rng& rng) {
  for (const double side : {-1.0, 1.0}) {
    if (rng.uniform() < 0.35) continue;
    const double x = rng.uniform(0.3, 2.6);
    add_box(world, place, {x, side * half - 0.05, 0.0}, {x + 0.95, side * half + 0.05, 2.05}, Material::wood);
    add_box(world, place, {x + 0.8, side * (half - 0.09) - 0.04, 0.95}, {x + 0.9, side * (half - 0.09) + 0.04, 1.05},
            Material::metal);
  }
}

void add_pillars(World& world, const Place& place, double half, double height) {
  for (const double side : {-1.0, 1.0})
    add_box(world, place, {0.0, side * half - 0.15, -0.3}, {0.4, side * half + 0.15, height}, Material::wall);
}

void add_railings(World& world, const Place& place, double half) {
  for (const double side : {-half, half}) {
    add_cylinder(world, place, {0.0, side, -0.3}, 0.04, 1.4, Material::metal);
    for (const double height : {0.55, 1.05})
      add_box(world, place, {-joint, side - 0.03, height - 0.03}, {passage_piece + joint, side + 0.03, height + 0.03},
              Material::metal);
  }
}

}  // namespace

double half_width(PassageKind kind, const StreetOptions& streets) {
  return kind == PassageKind::corridor ? 1.7 : streets.half_road + 0.4;
}

void add_passage_piece(World& world, const Place& place, PassageKind kind, const StreetOptions& streets, Rng rng) {
  if (kind == PassageKind::open) return add_railings(world, place, half_width(kind, streets));
  const bool corridor = kind == PassageKind::corridor;
  const double half = half_width(kind, streets);
  const double height = corridor ? 2.8 : 5.6;
  const double thickness = corridor ? 1.0 : 0.8;
  for (const double side : {-1.0, 1.0}) {
    const double inner = side * half;
    const double outer = side * (half + thickness);
    add_box(world, place, {-joint, std::min(inner, outer), -0.5},
            {passage_piece + joint, std::max(inner, outer), height}, Material::wall);
  }
  add_box(world, place, {-joint, -half - thickness, height}, {passage_piece + joint, half + thickness, height + 0.4},
          Material::wall);
  if (corridor)
    add_doors(world, place, half, rng);
  else
    add_pillars(world, place, half, height);
}

}  // namespace chainslam::simulator
