#include "simulator/roadside.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "simulator/building.hpp"
#include "simulator/furniture.hpp"
#include "simulator/taken_plots.hpp"

namespace chainslam::simulator {

namespace {

/// What a side of the street is like.
enum class Character { terrace, houses, gardens, wood, open };

struct Stretch {
  Character character;
  FenceKind fence;
  bool fenced;
  double setback;  ///< of the houses behind the building line, metres
  Index storeys;   ///< at most
};

Stretch draw_stretch(Rng& rng) {
  constexpr std::array<double, 5> parts{0.2, 0.4, 0.15, 0.13, 0.12};
  double lot = rng.uniform();
  std::size_t kind = 0;
  while (kind + 1 < parts.size() && lot >= parts[kind]) lot -= parts[kind++];
  return {.character = static_cast<Character>(kind),
          .fence = static_cast<FenceKind>(rng.uniform_index(3)),
          .fenced = rng.uniform() < 0.6,
          .setback = kind == 0 ? rng.uniform(0.0, 1.0) : rng.uniform(2.0, 9.0),
          .storeys = kind == 0 ? 2 + rng.uniform_index(3) : 1 + rng.uniform_index(2)};
}

class Roadside {
 public:
  Roadside(const DrivenPath& path, const PathTerrain& terrain, const RoadsideOptions& options, const Rng& rng)
      : path_(path),
        terrain_(terrain),
        options_(options),
        rng_(rng),
        half_road_(terrain.options().half_road),
        building_line_(half_road_ + terrain.options().pavement) {}

  World build() && {
    world_.ground = terrain_.lay_ground(rng_.fork(0));
    for (const double side : {-1.0, 1.0}) {
      const Rng rng = rng_.fork(side < 0.0 ? 1 : 2);
      line_with_plots(side, rng.fork(0));
      park_cars(side, rng.fork(1));
      furnish(side, rng.fork(2));
    }
    fill_up(rng_.fork(3));
    return std::move(world_);
  }

 private:
  [[nodiscard]] std::size_t sample_at(double along) const {
    const auto& samples = path_.samples();
    const auto found = std::ranges::lower_bound(samples, along, {}, &PathSample::along);
    return static_cast<std::size_t>(std::min(found, samples.end() - 1) - samples.begin());
  }

  /// A rectangle beside the path, its near edge `offset` away, its width along the street.
  [[nodiscard]] Plot beside(const PathSample& sample, double side, double offset, double width, double depth) const {
    return {.center = sample.position() + side * (offset + 0.5 * depth) * sample.left(),
            .axis = sample.direction,
            .half = {0.5 * width, 0.5 * depth}};
  }

  /// Takes the plot if nothing stands there and nobody drives there.
  bool take(const Plot& plot, double clearance) {
    if (!plots_.is_free(plot) || !path_.is_clear(plot, clearance)) return false;
    plots_.take(plot);
    return true;
  }
  bool take(const Plot& plot) { return take(plot, options_.clearance); }

  /// Upright on the ground, x along `direction`.
  [[nodiscard]] Place standing(const Eigen::Vector2d& position, const Eigen::Vector2d& direction) const {
    return upright({position.x(), position.y(), terrain_.surface(position)}, direction);
  }

  /// Calls `make(sample, rng)` along the path, which says how far on the next place is; not where an earlier pass was.
  template <class Make>
  void walk(Rng rng, const Make& make) {
    for (double along = rng.uniform(0.0, 4.0); along < path_.last_along();) {
      const std::size_t i = sample_at(along);
      const double here = path_.samples()[i].along;
      if (here > along + 1.0) along = here;  // the next drive begins
      const bool again = path_.was_passed_before(i, building_line_);
      along += again ? 2.0 : make(path_.samples()[i], rng);
    }
  }

  void line_with_plots(double side, Rng rng) {
    Stretch stretch = draw_stretch(rng);
    double until = rng.uniform(options_.least_stretch, options_.most_stretch);
    walk(rng, [&](const PathSample& sample, Rng& draw) {
      if (sample.along > until) {
        stretch = draw_stretch(draw);
        until = sample.along + draw.uniform(options_.least_stretch, options_.most_stretch);
      }
      const Rng own = draw.fork(static_cast<std::uint64_t>(sample.along * 16.0));
      switch (stretch.character) {
        case Character::terrace:
        case Character::houses:
          return line_with_house(sample, side, stretch, own);
        case Character::gardens:
          return line_with_garden(sample, side, stretch, own);
        case Character::wood:
          return line_with_wood(sample, side, own);
        case Character::open:
          break;
      }
      return 6.0;
    });
  }

  double line_with_house(const PathSample& sample, double side, const Stretch& stretch, Rng rng) {
    const bool dense = stretch.character == Character::terrace;
    if (rng.uniform() > options_.most_built) return line_with_garden(sample, side, stretch, rng);
    const double width = dense ? rng.uniform(6.0, 14.0) : rng.uniform(8.0, 15.0);
    const double gap = dense ? (rng.uniform() < 0.8 ? 0.1 : rng.uniform(2.0, 6.0)) : rng.uniform(3.0, 10.0);
    const double setback = building_line_ + stretch.setback + rng.uniform(0.0, dense ? 0.4 : 2.5);
    const double full_depth = rng.uniform(8.0, 13.0);
    for (const double depth : {full_depth, 0.6 * full_depth}) {
      const Plot plot = beside(sample, side, setback, width, depth);
      // Balconies, canopies and roofs stand out from the plot by up to 1.1 m.
      if (!take(plot, options_.clearance + 1.2)) continue;
      raise(plot, side, 1 + rng.uniform_index(stretch.storeys), rng.fork(1));
      if (stretch.fenced && stretch.setback > 1.5) fence(sample, side, width, stretch.fence, rng.fork(2));
      for (unsigned i = 0; i < 3; ++i)  // front gardens, and what grows in the gaps
        shrub(sample.position() + rng.uniform(-0.6, 0.6) * (width + gap) * sample.direction +
                  side * rng.uniform(building_line_ + 0.5, setback + 1.0) * sample.left(),
              rng.fork(3 + i));
      return width + gap;
    }
    return 3.0;
  }

  /// A house whose front looks at the street.
  void raise(const Plot& plot, double side, Index storeys, const Rng& rng) {
    const Eigen::Vector2d front = plot.at(0.0, -side);
    double lowest = terrain_.surface(front);
    for (const double x : {-1.0, 1.0})
      for (const double y : {-1.0, 1.0}) lowest = std::min(lowest, terrain_.surface(plot.at(x, y)));
    const Place place = standing(front, side * plot.axis);
    const BuildingPlan plan{.place = place,
                            .width = 2.0 * plot.half.x(),
                            .depth = 2.0 * plot.half.y(),
                            .foundation = place.origin.z() - lowest + 0.3,
                            .storeys = storeys};
    add_building(world_, plan, rng);
  }

  double line_with_garden(const PathSample& sample, double side, const Stretch& stretch, Rng rng) {
    const double width = rng.uniform(6.0, 12.0);
    fence(sample, side, width, stretch.fence, rng.fork(0));
    const Index trees = 1 + rng.uniform_index(3);
    for (Index i = 0; i < trees; ++i)
      plant(sample.position() + rng.uniform(-0.5, 0.5) * width * sample.direction +
                side * (building_line_ + rng.uniform(2.0, 9.0)) * sample.left(),
            rng.uniform(0.6, 1.4), rng.fork(10U + static_cast<unsigned>(i)));
    return width;
  }

  double line_with_wood(const PathSample& sample, double side, Rng rng) {
    for (unsigned i = 0; i < 4; ++i)
      plant(sample.position() + rng.uniform(-2.0, 2.0) * sample.direction +
                side * (building_line_ + rng.uniform(0.5, 14.0)) * sample.left(),
            rng.uniform(0.7, 1.8), rng.fork(i));
    shrub(sample.position() + side * (building_line_ + rng.uniform(0.0, 3.0)) * sample.left(), rng.fork(9));
    return rng.uniform(3.0, 6.0);
  }

  /// The crowns of large trees begin above every vehicle, and may reach over the road.
  bool plant(const Eigen::Vector2d& position, double size, const Rng& rng) {
    const double trunk = 0.3 * size;
    const double crown = size < 1.2 ? 2.4 * size : 0.9 * size;
    if (!take({.center = position, .axis = {1.0, 0.0}, .half = {trunk, trunk}}, options_.clearance + crown))
      return false;
    add_tree(world_, standing(position, {1.0, 0.0}), size, rng);
    return true;
  }

  void shrub(const Eigen::Vector2d& position, Rng rng) {
    const double height = rng.uniform(0.4, 1.1);  // one after the other: arguments have no order of evaluation
    const double across = rng.uniform(0.4, 1.3);
    const Eigen::Vector3d radii(rng.uniform(0.4, 1.3), across, height);
    if (!take({.center = position, .axis = {1.0, 0.0}, .half = radii.head<2>()})) return;
    add_ellipsoid(world_, standing(position, {1.0, 0.0}), {0.0, 0.0, 0.4 * radii.z()}, radii, Material::foliage);
  }

  /// Along the building line, with a gate.
  void fence(const PathSample& sample, double side, double width, FenceKind kind, Rng rng) {
    constexpr double piece = 1.8;
    const double gate = rng.uniform(-0.4, 0.4) * width;
    for (double x = -0.5 * width; x + piece < 0.5 * width; x += piece) {
      if (std::abs(x + 0.5 * piece - gate) < piece) continue;
      const PathSample& here = path_.samples()[sample_at(sample.along + x)];
      const Plot plot = beside(here, side, building_line_ + 0.1, piece, 0.9);
      if (!take(plot)) continue;
      const Eigen::Vector2d from = plot.at(-1.0, 0.0), to = plot.at(1.0, 0.0);
      const Place level = standing(from, plot.axis);
      const double climb = std::atan2(terrain_.surface(to) - terrain_.surface(from), piece);
      const Place inclined{level.origin,
                           level.rotation * Eigen::AngleAxisd(-climb, Eigen::Vector3d::UnitY()).toRotationMatrix()};
      add_fence(world_, inclined, piece, kind, rng.fork(1));
    }
  }

  void park_cars(double side, const Rng& all) {
    walk(all, [&](const PathSample& sample, Rng& draw) {
      Rng rng = draw.fork(static_cast<std::uint64_t>(sample.along * 16.0));
      const double busy = std::sin(0.013 * sample.along + 4.0 * side) + 1.0;  // some streets have more of them
      if (rng.uniform() > options_.parked * busy) return rng.uniform(5.5, 7.0);
      const double depth = 2.0;
      const Plot plot = beside(sample, side, half_road_ - depth - 0.1 + rng.uniform(0.0, 0.6), 5.5, depth);
      if (!take(plot)) return 3.0;
      const Place level = standing(plot.center, plot.axis);
      const double climb = std::atan2(terrain_.height(plot.at(1.0, 0.0)) - terrain_.height(plot.at(-1.0, 0.0)), 5.5);
      const Eigen::Vector3d foot(level.origin.x(), level.origin.y(), terrain_.height(plot.center));
      add_car(world_, {foot, level.rotation * Eigen::AngleAxisd(-climb, Eigen::Vector3d::UnitY()).toRotationMatrix()},
              rng);
      return rng.uniform(5.6, 6.6);
    });
  }

  /// Lamps, signs, trees and boxes along the kerb.
  void furnish(double side, const Rng& all) {
    const bool avenue = Rng(all).uniform() < 0.5;
    walk(all.fork(1), [&](const PathSample& sample, Rng& draw) {
      Rng rng = draw.fork(static_cast<std::uint64_t>(sample.along * 16.0));
      const Plot plot = beside(sample, side, half_road_ + 0.3, 1.0, 0.5);
      const double what = rng.uniform();
      if (what < (avenue ? 0.35 : 0.12))
        return plant(plot.center, rng.uniform(0.6, 1.5), rng) ? rng.uniform(6.0, 12.0) : 4.0;
      if (what > 0.92 || !take(plot)) return rng.uniform(3.0, 8.0);
      const Place place = standing(plot.center, -side * sample.direction);  // y points to the road
      if (what < 0.5)
        add_lamp(world_, place, rng);
      else if (what < 0.68)
        add_sign(world_, place, rng);
      else
        add_street_box(world_, place, rng);
      return rng.uniform(7.0, 16.0);
    });
  }

  /// Trees, shrubs, sheds and the houses of other streets on what is left.
  void fill_up(Rng rng) {
    const Eigen::Vector2d size = terrain_.size();
    const auto attempts = static_cast<std::int64_t>(size.prod() / options_.area_per_tree);
    for (std::int64_t i = 0; i < attempts; ++i) {
      Rng own = rng.fork(static_cast<std::uint64_t>(i));
      const Eigen::Vector2d position =
          terrain_.origin() + Eigen::Vector2d(own.uniform(3.0, size.x() - 3.0), own.uniform(3.0, size.y() - 3.0));
      if (path_.distance(position, options_.depth) >= options_.depth ||
          path_.distance(position, building_line_ + 2.0) < building_line_ + 2.0)
        continue;
      const double angle = own.uniform(0.0, std::numbers::pi);
      const double what = own.uniform();
      if (what < 0.12) {
        const Plot plot{.center = position,
                        .axis = {std::cos(angle), std::sin(angle)},
                        .half = {own.uniform(3.0, 7.0), own.uniform(3.0, 6.0)}};
        if (take(plot, building_line_)) raise(plot, 1.0, 1 + own.uniform_index(2), own.fork(1));
      } else if (what < 0.6) {
        plant(position, own.uniform(0.6, 1.7), own.fork(1));
      } else {
        shrub(position, own.fork(1));
      }
    }
  }

  const DrivenPath& path_;
  const PathTerrain& terrain_;
  RoadsideOptions options_;
  Rng rng_;
  double half_road_;
  double building_line_;
  World world_;
  TakenPlots plots_;
};

}  // namespace

World make_roadside(const DrivenPath& path, const PathTerrain& terrain, const RoadsideOptions& options,
                    const Rng& rng) {
  return Roadside(path, terrain, options, rng).build();
}

}  // namespace chainslam::simulator
