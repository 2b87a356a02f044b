#include "simulator/building.hpp"

#include <algorithm>
#include <numbers>
#include <vector>

namespace chainslam::simulator {

namespace {

/// What the sides of one house have in common.
struct Style {
  double recess;               ///< windows behind the wall, metres
  double bay;                  ///< from window to window, metres
  double window_width;         ///< as a part of the bay
  double sill;                 ///< lower edge of the windows above the floor, metres
  double window_height;        ///< metres
  double ledge;                ///< how far the ledges stand out; 0: none
  std::vector<double> floors;  ///< z of each storey's floor, and of the eaves
};

Style draw_style(const BuildingPlan& plan, Rng& rng) {
  Style style{.recess = rng.uniform(0.12, 0.35),
              .bay = rng.uniform(2.3, 4.0),
              .window_width = rng.uniform(0.4, 0.65),
              .sill = rng.uniform(0.5, 1.0),
              .window_height = rng.uniform(1.2, 1.7),
              .ledge = rng.uniform() < 0.6 ? rng.uniform(0.06, 0.22) : 0.0,
              .floors = {0.0}};
  style.floors.push_back(rng.uniform(3.0, 4.2));
  const double storey = rng.uniform(2.7, 3.3);
  for (Index i = 1; i < plan.storeys; ++i) style.floors.push_back(style.floors.back() + storey);
  return style;
}

/// One side, seen from outside: x to the right along it, y into the house, z up, origin at its left end at street
/// level.
struct Side {
  Place place;
  double length;
  double foundation;
};

void add_blank_wall(World& world, const Side& side, const Style& style) {
  add_box(world, side.place, {0.0, 0.0, -side.foundation}, {side.length, style.recess, style.floors.back()},
          Material::wall);
}

void add_piers(World& world, const Side& side, const Style& style, int bays, Rng& rng) {
  const double bay = side.length / bays;
  const double half_pier = 0.5 * bay * (1.0 - style.window_width);
  for (int i = 0; i <= bays; ++i) {
    const double shift = i == 0 || i == bays ? 0.0 : rng.uniform(-0.15, 0.15);
    const double middle = i * bay + shift;
    add_box(world, side.place, {std::max(0.0, middle - half_pier), 0.0, -side.foundation},
            {std::min(side.length, middle + half_pier), style.recess, style.floors.back()}, Material::wall);
  }
}

/// The bands between the windows of one storey and those of the next, and the ledges on them.
void add_bands(World& world, const Side& side, const Style& style, Rng& rng) {
  double below = -side.foundation;
  for (std::size_t storey = 0; storey + 1 < style.floors.size(); ++storey) {
    const double sill = style.floors[storey] + style.sill;
    const double inward = style.recess * rng.uniform(0.0, 0.3);
    add_box(world, side.place, {0.0, inward, below}, {side.length, style.recess, sill}, Material::wall);
    if (storey > 0 && style.ledge > 0.0)
      add_box(world, side.place, {0.0, -style.ledge, style.floors[storey] - 0.1},
              {side.length, style.recess, style.floors[storey] + 0.12}, Material::wall);
    below = std::min(sill + style.window_height, style.floors[storey + 1] - 0.2);
  }
  add_box(world, side.place, {0.0, 0.0, below}, {side.length, style.recess, style.floors.back()}, Material::wall);
}

void add_doorway(World& world, const Side& side, const Style& style, Rng& rng) {
  const double middle = side.length * rng.uniform(0.2, 0.8);
  add_box(world, side.place, {middle - 0.55, -0.04, -side.foundation}, {middle + 0.55, style.recess, 2.2},
          Material::wood);
  if (rng.uniform() < 0.5)  // a canopy
    add_box(world, side.place, {middle - 1.0, -0.9, 2.45}, {middle + 1.0, style.recess, 2.6}, Material::wall);
  if (rng.uniform() < 0.5)  // steps
    add_box(world, side.place, {middle - 0.8, -0.7, -side.foundation}, {middle + 0.8, 0.0, 0.18}, Material::pavement);
}

void add_balconies(World& world, const Side& side, const Style& style, int bays, Rng& rng) {
  const double bay = side.length / bays;
  for (std::size_t storey = 1; storey + 1 < style.floors.size(); ++storey)
    for (int i = 0; i < bays; ++i) {
      if (rng.uniform() > 0.35) continue;
      const double left = i * bay + 0.25;
      const double right = (i + 1) * bay - 0.25;
      const double z = style.floors[storey];
      add_box(world, side.place, {left, -1.1, z - 0.15}, {right, 0.0, z}, Material::wall);
      add_box(world, side.place, {left, -1.1, z}, {right, -1.05, z + 0.95}, Material::metal);
    }
}

void add_windowed_wall(World& world, const Side& side, const Style& style, Rng& rng) {
  const int bays = std::max(1, static_cast<int>(side.length / style.bay));
  add_piers(world, side, style, bays, rng);
  add_bands(world, side, style, rng);
  if (rng.uniform() < 0.25) add_balconies(world, side, style, bays, rng);
}

/// Two slabs that lean on each other along the ridge, the gable walls under them left open to the core.
void add_gable_roof(World& world, const Place& place, double width, double depth, double eaves, Rng& rng) {
  const double overhang = rng.uniform(0.2, 0.5);
  const double pitch = rng.uniform(0.5, 0.8);
  const double slab = (0.5 * depth + overhang) / std::cos(pitch);
  for (const double sign : {1.0, -1.0}) {
    const Eigen::Matrix3d lean = Eigen::AngleAxisd(sign * pitch, Eigen::Vector3d::UnitX()).toRotationMatrix();
    const double y = sign > 0.0 ? -overhang : depth + overhang;
    const Place slope = place.moved({0.0, y, eaves - overhang * std::tan(pitch)}, lean);
    const double from = sign > 0.0 ? 0.0 : -slab;
    add_box(world, slope, {-0.5 * width, from, -0.15}, {0.5 * width, from + slab, 0.1}, Material::wall);
  }
  const double ridge = eaves + 0.5 * depth * std::tan(pitch);
  const double chimney = rng.uniform(-0.35, 0.35) * width;
  add_box(world, place, {chimney - 0.3, 0.5 * depth - 0.3, eaves}, {chimney + 0.3, 0.5 * depth + 0.3, ridge + 0.8},
          Material::wall);
}

void add_flat_roof(World& world, const Place& place, double width, double depth, double eaves, Rng& rng) {
  const double parapet = eaves + rng.uniform(0.3, 1.0);
  const double half = 0.5 * width;
  add_box(world, place, {-half, 0.0, eaves}, {half, 0.25, parapet}, Material::wall);
  add_box(world, place, {-half, depth - 0.25, eaves}, {half, depth, parapet}, Material::wall);
  const double hut = rng.uniform(-0.2, 0.2) * width;
  add_box(world, place, {hut - 1.5, 0.5 * depth - 1.2, eaves}, {hut + 1.5, 0.5 * depth + 1.2, eaves + 2.2},
          Material::wall);
}

}  // namespace

void add_building(World& world, const BuildingPlan& plan, Rng rng) {
  const Style style = draw_style(plan, rng);
  const double half = 0.5 * plan.width;
  const double eaves = style.floors.back();
  add_box(world, plan.place, {-half + style.recess, style.recess, -plan.foundation},
          {half - style.recess, plan.depth - style.recess, eaves - 0.1}, Material::glass);
  add_box(world, plan.place, {-half, 0.0, eaves - 0.3}, {half, plan.depth, eaves}, Material::wall);

  constexpr double quarter_turn = 0.5 * std::numbers::pi;
  const auto side = [&](const Eigen::Vector3d& corner, double turn, double length) {
    return Side{plan.place.moved(corner, yawed(turn)), length, plan.foundation};
  };
  const Side front = side({-half, 0.0, 0.0}, 0.0, plan.width);
  add_windowed_wall(world, front, style, rng);
  add_doorway(world, front, style, rng);
  const Side others[] = {side({half, 0.0, 0.0}, quarter_turn, plan.depth),
                         side({half, plan.depth, 0.0}, 2.0 * quarter_turn, plan.width),
                         side({-half, plan.depth, 0.0}, 3.0 * quarter_turn, plan.depth)};
  for (const Side& other : others) {
    if (rng.uniform() < 0.5)
      add_windowed_wall(world, other, style, rng);
    else
      add_blank_wall(world, other, style);
  }
  if (rng.uniform() < 0.6)
    add_gable_roof(world, plan.place, plan.width, plan.depth, eaves, rng);
  else
    add_flat_roof(world, plan.place, plan.width, plan.depth, eaves, rng);
}

}  // namespace chainslam::simulator
