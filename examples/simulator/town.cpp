#include "simulator/town.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "simulator/building.hpp"
#include "simulator/day.hpp"
#include "simulator/furniture.hpp"
#include "simulator/passage.hpp"
#include "simulator/plot.hpp"

namespace chainslam::simulator {

namespace {

constexpr double kerb = 0.12;                 // metres
constexpr double open_to_either_side = 40.0;  // of an open stretch, metres

/// One side of a street, walked from its beginning with the houses to the left.
struct Frontage {
  Eigen::Vector2d start;
  Eigen::Vector2d along;   ///< unit vector
  Eigen::Vector2d inward;  ///< unit vector, from the road to the houses
  double length;           ///< metres

  [[nodiscard]] Eigen::Vector2d at(double s, double d) const { return start + s * along + d * inward; }
};

/// Marks what is added to a world during its life.
class Marking {
 public:
  Marking(World& world, Presence presence)
      : world_(world),
        presence_(presence),
        boxes_(world.boxes.size()),
        cylinders_(world.cylinders.size()),
        ellipsoids_(world.ellipsoids.size()) {}
  Marking(const Marking&) = delete;
  Marking& operator=(const Marking&) = delete;
  ~Marking() {
    mark(world_.boxes, boxes_);
    mark(world_.cylinders, cylinders_);
    mark(world_.ellipsoids, ellipsoids_);
  }

 private:
  /// What is marked already, as less lasting, stays so.
  template <class Shape>
  void mark(std::vector<Shape>& shapes, std::size_t begin) const {
    for (std::size_t i = begin; i < shapes.size(); ++i) shapes[i].presence = std::max(shapes[i].presence, presence_);
  }

  World& world_;
  Presence presence_;
  std::size_t boxes_, cylinders_, ellipsoids_;
};

/// A place for one car along the kerb.
struct ParkingBay {
  double gap;   ///< kerb to the car's middle, metres
  double skew;  ///< of the car to the street
  double lot;   ///< 0 to 1, for whether it is taken

  explicit ParkingBay(Rng& rng) : gap(rng.uniform(0.95, 1.1)), skew(rng.uniform(-0.03, 0.03)), lot(rng.uniform()) {}
};

class Builder {
 public:
  Builder(const TownOptions& options, const Rng& rng, Index day)
      : options_(options),
        rng_(rng),
        day_(day),
        town_{.streets = StreetGrid(options.streets, rng.fork(0)),
              .terrain = Terrain(options.steepness, rng.fork(1)),
              .world = {},
              .narrow = {}},
        streets_(town_.streets.streets()),
        building_line_(options.streets.half_road + options.streets.pavement) {}

  Town build() && {
    lay_ground();
    for (const Passage& passage : options_.passages) lead_through(passage);
    std::uint64_t number = 0;
    for (const Street& street : streets_) {
      const Eigen::Vector2d along = (street.to - street.from).normalized();
      const double length = (street.to - street.from).norm();
      const Eigen::Vector2d left(-along.y(), along.x());
      for (const Frontage& side :
           {Frontage{street.from, along, left, length}, Frontage{street.to, -along, -left, length}}) {
        line_with_plots(side, rng_.fork(2).fork(number));
        park_cars(side, rng_.fork(3).fork(number));
        furnish(side, rng_.fork(4).fork(number));
        if (options_.seasons && is_winter(day_)) clear_snow(side, on_day(rng_.fork(7).fork(number), day_));
        ++number;
      }
    }
    plant_yards(rng_.fork(5));
    return std::move(town_);
  }

 private:
  [[nodiscard]] double off_road_height(const Eigen::Vector2d& position) const {
    return town_.terrain.height(position) + kerb;
  }
  [[nodiscard]] Place standing(const Eigen::Vector2d& position, const Eigen::Vector2d& direction) const {
    return upright({position.x(), position.y(), off_road_height(position)}, direction);
  }
  /// A place whose z axis is the terrain's normal.
  [[nodiscard]] Place leaning(const Eigen::Vector2d& position, const Eigen::Vector2d& direction, double lift) const {
    const Eigen::Vector2d slope = town_.terrain.slope(position);
    const Eigen::Vector3d z = Eigen::Vector3d(-slope.x(), -slope.y(), 1.0).normalized();
    const Eigen::Vector3d x = Eigen::Vector3d(direction.x(), direction.y(), slope.dot(direction)).normalized();
    Place place{.origin = {position.x(), position.y(), town_.terrain.height(position) + lift}, .rotation = {}};
    place.rotation << x, z.cross(x), z;
    return place;
  }

  void lay_ground() {
    HeightField& ground = town_.world.ground;
    Eigen::AlignedBox2d area;
    for (const Street& street : streets_) area.extend(street.from).extend(street.to);
    ground.spacing = static_cast<float>(options_.ground_spacing);
    ground.origin = (area.min().array() - options_.border).matrix().cast<float>();
    const Eigen::Array2d size = (area.sizes().array() + 2.0 * options_.border) / options_.ground_spacing;
    ground.columns = static_cast<Index>(size.x()) + 1;
    ground.rows = static_cast<Index>(size.y()) + 1;
    const std::size_t samples = ground.at(0, ground.rows);
    ground.heights.resize(samples);
    ground.materials.assign(samples, Material::lawn);

    std::vector<float> to_street(samples, infinite_distance);
    for (const Street& street : streets_) measure_distances(street, to_street);
    Rng roughness = rng_.fork(6);
    for (Index row = 0; row < ground.rows; ++row)
      for (Index column = 0; column < ground.columns; ++column) {
        const std::size_t i = ground.at(column, row);
        const double distance = static_cast<double>(to_street[i]);
        const bool road = distance < options_.streets.half_road;
        const bool pavement = distance < building_line_;
        ground.materials[i] = road ? Material::road : pavement ? Material::pavement : Material::lawn;
        const double unevenness = roughness.uniform(-1.0, 1.0) * (pavement ? 0.003 : 0.03);
        const double lift = road ? 0.0 : kerb;
        ground.heights[i] = static_cast<float>(town_.terrain.height(sample(column, row)) + lift + unevenness);
      }
  }

  [[nodiscard]] Eigen::Vector2d sample(Index column, Index row) const {
    return town_.world.ground.origin.cast<double>() + options_.ground_spacing * Eigen::Vector2d(column, row);
  }

  void measure_distances(const Street& street, std::vector<float>& to_street) const {
    const HeightField& ground = town_.world.ground;
    const double reach = building_line_ + 1.0;
    const Eigen::Vector2d origin = ground.origin.cast<double>();
    const Eigen::Array2d low = (street.from.cwiseMin(street.to) - origin).array() - reach;
    const Eigen::Array2d high = (street.from.cwiseMax(street.to) - origin).array() + reach;
    const auto index = [&](double value, Index count) {
      return std::clamp(static_cast<Index>(value / options_.ground_spacing), Index{0}, count - 1);
    };
    for (Index row = index(low.y(), ground.rows); row <= index(high.y(), ground.rows); ++row)
      for (Index column = index(low.x(), ground.columns); column <= index(high.x(), ground.columns); ++column) {
        float& nearest = to_street[ground.at(column, row)];
        nearest = std::min(nearest, static_cast<float>(distance_to_street(sample(column, row), street)));
      }
  }

  /// Free of other plots and of all roads and pavements.
  [[nodiscard]] bool is_free(const Plot& plot) const {
    for (const Plot& other : plots_) {
      const double reach = plot.radius() + other.radius();
      if ((plot.center - other.center).squaredNorm() < reach * reach && overlap(plot, other)) return false;
    }
    constexpr int steps = 8;
    for (const Street& street : streets_) {
      if (distance_to_street(plot.center, street) > plot.radius() + building_line_) continue;
      for (int i = -steps; i <= steps; ++i) {
        const double part = static_cast<double>(i) / steps;
        for (const Eigen::Vector2d& edge :
             {plot.at(part, 1.0), plot.at(part, -1.0), plot.at(1.0, part), plot.at(-1.0, part)})
          if (distance_to_street(edge, street) < building_line_ - 0.05) return false;
      }
    }
    return true;
  }

  /// Walls and a roof over a stretch of street.
  void lead_through(const Passage& passage) {
    const Eigen::Vector2d from = town_.streets.position(passage.from);
    const Eigen::Vector2d street = town_.streets.position(passage.to) - from;
    const Eigen::Vector2d along = street.normalized();
    const NarrowStretch stretch{
        .from = from + passage.begin * street, .to = from + passage.end * street, .reach = options_.streets.half_road};
    passages_.push_back(stretch);
    if (passage.kind == PassageKind::corridor) town_.narrow.push_back(stretch);
    const double length = (stretch.to - stretch.from).norm();
    if (passage.kind == PassageKind::open)
      plots_.push_back(
          {.center = 0.5 * (stretch.from + stretch.to), .axis = along, .half = {0.5 * length, open_to_either_side}});
    const Rng rng = rng_.fork(8).fork(passages_.size());
    for (double s = 0.0; s + passage_piece <= length; s += passage_piece)
      add_passage_piece(town_.world, leaning(stretch.from + s * along, along, 0.0), passage.kind, options_.streets,
                        rng.fork(static_cast<std::uint64_t>(s)));
  }

  /// Whether a place at the kerb is within a passage, or at its mouth.
  [[nodiscard]] bool is_in_passage(const Eigen::Vector2d& position) const {
    return std::ranges::any_of(passages_, [&](const NarrowStretch& passage) {
      return distance_to_street(position, {passage.from, passage.to}) < building_line_ + 2.0;
    });
  }

  [[nodiscard]] bool is_bare() const { return options_.seasons && is_winter(day_); }

  void plant_tree(const Place& place, double size, const Rng& rng) {
    const Marking marking(town_.world, options_.seasons ? Presence::changing : Presence::lasting);
    add_tree(town_.world, place, size, rng, is_bare());
  }

  void clear_snow(const Frontage& side, Rng rng) {
    const Marking marking(town_.world, Presence::changing);
    for (double s = options_.clear_of_crossing; s < side.length - options_.clear_of_crossing;
         s += rng.uniform(1.5, 8.0)) {
      const Eigen::Vector2d position = side.at(s, options_.streets.half_road + rng.uniform(0.9, 1.4));
      if (!is_in_passage(position)) add_heap(town_.world, standing(position, side.along), rng.fork(1));
    }
  }

  void line_with_plots(const Frontage& side, Rng rng) {
    if (rng.fork(1).uniform() < options_.open_sides) return;
    alike_ = rng.fork(2).uniform() < options_.alike;
    design_ = rng.fork(3);
    double s = building_line_ + rng.uniform(0.0, 2.0);
    const HouseOptions& houses = options_.houses;
    const double one_width = Rng(design_).uniform(houses.least_width, houses.most_width);
    while (s < side.length - building_line_ - 8.0) {
      const double own_width = rng.uniform(houses.least_width, houses.most_width);
      const double width = alike_ ? one_width : own_width;
      const double kind = rng.uniform();
      const double gap = rng.uniform() < 0.35 ? 0.1 : rng.uniform(1.0, 5.0);
      const bool built = kind < options_.built ? place_house(side, s, width, rng) : lay_garden(side, s, width, rng);
      s += built ? width + gap : 2.0;
    }
  }

  bool place_house(const Frontage& side, double s, double width, Rng& rng) {
    const HouseOptions& houses = options_.houses;
    Rng drawn = alike_ ? design_.fork(1) : rng;
    const double setback =
        building_line_ + (drawn.uniform() < houses.at_the_street ? 0.05 : drawn.uniform(0.3, houses.most_setback));
    const double full_depth = drawn.uniform(houses.least_depth, houses.most_depth);
    const Index storeys = 1 + drawn.uniform_index(options_.max_storeys);
    if (!alike_) rng = drawn;
    for (const double depth : {full_depth, 0.6 * full_depth}) {
      const Plot plot{.center = side.at(s + 0.5 * width, setback + 0.5 * depth),
                      .axis = side.along,
                      .half = {0.5 * width, 0.5 * depth}};
      if (!is_free(plot)) continue;
      plots_.push_back(plot);
      double lowest = infinite_distance;
      for (const double x : {-1.0, 1.0})
        for (const double y : {-1.0, 1.0}) lowest = std::min(lowest, off_road_height(plot.at(x, y)));
      const Place front = standing(side.at(s + 0.5 * width, setback), side.along);
      const BuildingPlan plan{.place = front,
                              .width = width,
                              .depth = depth,
                              .foundation = std::max(0.0, front.origin.z() - lowest) + 0.3,
                              .storeys = storeys};
      raise(plan, alike_ ? design_ : rng.fork(static_cast<std::uint64_t>(plots_.size())), rng);
      return true;
    }
    return false;
  }

  /// The house, if it is finished, and its scaffolding.
  void raise(const BuildingPlan& plan, const Rng& design, const Rng& rng) {
    const Rng history = rng.fork(~static_cast<std::uint64_t>(plots_.size()));
    const bool late = history.fork(0).uniform() < options_.built_later;
    if (late && day_ < static_cast<Index>(history.fork(1).uniform(1.0, 200.0))) return;
    const Marking marking(town_.world, late ? Presence::changing : Presence::lasting);
    add_building(town_.world, plan, design);
    if (history.fork(2).uniform() >= options_.scaffolds || on_day(history.fork(3), day_).uniform() >= 0.5) return;
    const Marking scaffold(town_.world, Presence::changing);
    add_scaffold(town_.world, plan.place, 0.5 * plan.width, 2.9 * plan.storeys);
  }

  bool lay_garden(const Frontage& side, double s, double width, Rng& rng) {
    const Plot plot{
        .center = side.at(s + 0.5 * width, building_line_ + 4.2), .axis = side.along, .half = {0.5 * width, 4.0}};
    if (!is_free(plot)) return false;
    plots_.push_back(plot);
    const std::array kinds{FenceKind::pickets, FenceKind::wall, FenceKind::hedge};
    const FenceKind kind = kinds[static_cast<std::size_t>(rng.uniform_index(3))];
    const double gate = rng.uniform(0.2, 0.8) * width;
    constexpr double piece = 1.8;
    for (double x = 0.0; x + piece < width; x += piece) {
      if (std::abs(x + 0.5 * piece - gate) < piece) continue;
      const Place place = leaning(side.at(s + x, building_line_ + 0.5), side.along, kerb);
      add_fence(town_.world, place, piece, kind, rng.fork(1));
    }
    const int trees = 1 + rng.uniform_index(3);
    for (int i = 0; i < trees; ++i) {
      const double x = rng.uniform(1.5, width - 1.5);
      const double y = building_line_ + rng.uniform(2.5, 7.0);
      const double size = rng.uniform(0.7, 1.5);
      plant_tree(standing(side.at(s + x, y), side.along), size, rng.fork(10U + static_cast<unsigned>(i)));
    }
    return true;
  }

  /// Whether a thing is among the `part` of all that differ from day to day.
  [[nodiscard]] static Presence presence_of(const Rng& thing, double part) {
    return thing.fork(0).uniform() < part ? Presence::changing : Presence::lasting;
  }

  void park_cars(const Frontage& side, Rng rng) {
    for (double s = options_.clear_of_crossing + rng.uniform(0.0, 3.0); s < side.length - options_.clear_of_crossing;
         s += rng.uniform(5.4, 6.4)) {
      Rng car = rng.fork(static_cast<std::uint64_t>(s * 1000.0));
      ParkingBay bay(rng);
      const Marking marking(town_.world, presence_of(car, options_.parked_anew));
      if (day_ > 0 && presence_of(car, options_.parked_anew) == Presence::changing) {
        car = on_day(car, day_);
        bay = ParkingBay(car);
      }
      if (bay.lot >= options_.parked || is_in_passage(side.at(s, options_.streets.half_road))) continue;
      const Eigen::Vector2d direction = side.along + bay.skew * side.inward;
      add_car(town_.world, leaning(side.at(s, options_.streets.half_road - bay.gap), direction.normalized(), 0.0), car);
    }
  }

  /// Trees, lamps, signs and boxes along the kerb.
  void furnish(const Frontage& side, Rng rng) {
    const bool avenue = rng.uniform() < 0.5;
    std::uint64_t number = 0;
    for (double s = options_.clear_of_crossing - 4.0 + rng.uniform(0.0, 6.0);
         s < side.length - options_.clear_of_crossing + 4.0; s += rng.uniform(4.0, 9.0)) {
      const double offset = options_.streets.half_road + rng.uniform(0.5, 0.8);
      const Place place = standing(side.at(s, offset), -side.along);  // y points to the road
      double what = rng.uniform();
      const double size = rng.uniform(0.7, 1.2);
      Rng item = rng.fork(number++);
      if (is_in_passage(side.at(s, offset))) continue;
      const Presence presence = presence_of(item, options_.kerb_changes);
      const Marking marking(town_.world, presence);
      if (day_ > 0 && presence == Presence::changing) {
        item = on_day(item, day_);
        what = item.uniform();
      }
      if (what < (avenue ? 0.45 : 0.1))
        plant_tree(place, size, item);
      else if (what < 0.62)
        add_lamp(town_.world, place, item);
      else if (what < 0.72)
        add_sign(town_.world, place, item);
      else if (what < 0.84)
        add_street_box(town_.world, place, item);
      else if (what < 0.9)
        add_bollards(town_.world, place, item);
      else if (what < 0.94)
        add_shelter(town_.world, standing(side.at(s, offset + 0.4), -side.along), item);
    }
  }

  /// Trees and sheds on what is left between the houses.
  void plant_yards(Rng rng) {
    const HeightField& ground = town_.world.ground;
    const Eigen::Vector2d size = options_.ground_spacing * Eigen::Vector2d(ground.columns - 1, ground.rows - 1);
    const int attempts = static_cast<int>(size.prod() / options_.area_per_tree);
    for (int i = 0; i < attempts; ++i) {
      const double x = rng.uniform(3.0, size.x() - 3.0);
      const double y = rng.uniform(3.0, size.y() - 3.0);
      const double angle = rng.uniform(0.0, std::numbers::pi);
      const bool shed = rng.uniform() < 0.25;
      const double half = shed ? rng.uniform(1.2, 2.5) : 1.5;
      const Plot plot{.center = ground.origin.cast<double>() + Eigen::Vector2d(x, y),
                      .axis = {std::cos(angle), std::sin(angle)},
                      .half = {half, 0.8 * half}};
      if (!is_free(plot)) continue;
      plots_.push_back(plot);
      const Place place = standing(plot.center, plot.axis);
      const double scale = rng.uniform(0.7, 1.6);
      if (shed)
        add_box(town_.world, place, {-half, -0.8 * half, -0.8}, {half, 0.8 * half, 1.6 * scale + 0.8}, Material::wood);
      else
        plant_tree(place, scale, rng.fork(static_cast<std::uint64_t>(i)));
    }
  }

  const TownOptions& options_;
  Rng rng_;
  Index day_;
  Town town_;
  std::vector<Street> streets_;
  double building_line_;  ///< middle of the road to the houses, metres
  std::vector<Plot> plots_;
  std::vector<NarrowStretch> passages_;
  bool alike_ = false;  ///< whether the houses of the side that is being lined are all the same
  Rng design_;          ///< ... this one
};

}  // namespace

Town make_town(const TownOptions& options, const Rng& rng, Index day) { return Builder(options, rng, day).build(); }

}  // namespace chainslam::simulator
