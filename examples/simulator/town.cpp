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

namespace chainslam::simulator {

namespace {

constexpr double kerb = 0.12;             // metres
constexpr double clear_of_crossing = 12;  // nothing is parked or planted nearer to a crossing, metres

double distance_to_street(const Eigen::Vector2d& point, const Street& street) {
  const Eigen::Vector2d along = street.to - street.from;
  const double part = std::clamp((point - street.from).dot(along) / along.squaredNorm(), 0.0, 1.0);
  return (point - street.from - part * along).norm();
}

/// A rectangle on the ground.
struct Plot {
  Eigen::Vector2d center;
  Eigen::Vector2d axis;  ///< unit vector along `half.x()`
  Eigen::Vector2d half;  ///< half width and half depth, metres

  [[nodiscard]] Eigen::Vector2d at(double x, double y) const {
    return center + x * half.x() * axis + y * half.y() * Eigen::Vector2d(-axis.y(), axis.x());
  }
  [[nodiscard]] double radius() const { return half.norm(); }
};

/// Whether `axes` of the first plot separate the two (one half of the separating axis test).
bool separated_by_axes_of(const Plot& a, const Plot& b) {
  for (const int axis : {0, 1}) {
    const Eigen::Vector2d direction = axis == 0 ? a.axis : Eigen::Vector2d(-a.axis.y(), a.axis.x());
    const Eigen::Vector2d side(-b.axis.y(), b.axis.x());
    const double reach = b.half.x() * std::abs(b.axis.dot(direction)) + b.half.y() * std::abs(side.dot(direction));
    if (std::abs((b.center - a.center).dot(direction)) > a.half[axis] + reach) return true;
  }
  return false;
}

bool overlap(const Plot& a, const Plot& b) { return !separated_by_axes_of(a, b) && !separated_by_axes_of(b, a); }

/// One side of a street, walked from its beginning with the houses to the left.
struct Frontage {
  Eigen::Vector2d start;
  Eigen::Vector2d along;   ///< unit vector
  Eigen::Vector2d inward;  ///< unit vector, from the road to the houses
  double length;           ///< metres

  [[nodiscard]] Eigen::Vector2d at(double s, double d) const { return start + s * along + d * inward; }
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
              .world = {}},
        streets_(town_.streets.streets()),
        building_line_(options.streets.half_road + options.streets.pavement) {}

  Town build() && {
    lay_ground();
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

  void line_with_plots(const Frontage& side, Rng rng) {
    double s = building_line_ + rng.uniform(0.0, 2.0);
    while (s < side.length - building_line_ - 8.0) {
      const double width = rng.uniform(8.0, 18.0);
      const double kind = rng.uniform();
      const double gap = rng.uniform() < 0.35 ? 0.1 : rng.uniform(1.0, 5.0);
      const bool built = kind < 0.8 ? place_house(side, s, width, rng) : lay_garden(side, s, width, rng);
      s += built ? width + gap : 2.0;
    }
  }

  bool place_house(const Frontage& side, double s, double width, Rng& rng) {
    const double setback = building_line_ + (rng.uniform() < 0.3 ? 0.05 : rng.uniform(0.3, 4.0));
    const double full_depth = rng.uniform(8.0, 13.0);
    const Index storeys = 1 + rng.uniform_index(options_.max_storeys);
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
      add_building(town_.world, plan, rng.fork(static_cast<std::uint64_t>(plots_.size())));
      return true;
    }
    return false;
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
      add_tree(town_.world, standing(side.at(s + x, y), side.along), rng.uniform(0.7, 1.5),
               rng.fork(10U + static_cast<unsigned>(i)));
    }
    return true;
  }

  /// Whether a thing is among the `part` of all that differ from day to day; on the first day all are as they were.
  [[nodiscard]] bool is_changed(const Rng& thing, double part) const {
    return day_ > 0 && thing.fork(0).uniform() < part;
  }

  void park_cars(const Frontage& side, Rng rng) {
    for (double s = clear_of_crossing + rng.uniform(0.0, 3.0); s < side.length - clear_of_crossing;
         s += rng.uniform(5.4, 6.4)) {
      Rng car = rng.fork(static_cast<std::uint64_t>(s * 1000.0));
      ParkingBay bay(rng);
      if (is_changed(car, options_.parked_anew)) {
        car = on_day(car, day_);
        bay = ParkingBay(car);
      }
      if (bay.lot >= options_.parked) continue;
      const Eigen::Vector2d direction = side.along + bay.skew * side.inward;
      add_car(town_.world, leaning(side.at(s, options_.streets.half_road - bay.gap), direction.normalized(), 0.0), car);
    }
  }

  /// Trees, lamps, signs and boxes along the kerb.
  void furnish(const Frontage& side, Rng rng) {
    const bool avenue = rng.uniform() < 0.5;
    std::uint64_t number = 0;
    for (double s = clear_of_crossing - 4.0 + rng.uniform(0.0, 6.0); s < side.length - clear_of_crossing + 4.0;
         s += rng.uniform(4.0, 9.0)) {
      const double offset = options_.streets.half_road + rng.uniform(0.5, 0.8);
      const Place place = standing(side.at(s, offset), -side.along);  // y points to the road
      double what = rng.uniform();
      const double size = rng.uniform(0.7, 1.2);
      Rng item = rng.fork(number++);
      if (is_changed(item, options_.kerb_changes)) {
        item = on_day(item, day_);
        what = item.uniform();
      }
      if (what < (avenue ? 0.45 : 0.1))
        add_tree(town_.world, place, size, item);
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
    const int attempts = static_cast<int>(size.prod() / 80.0);
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
        add_tree(town_.world, place, scale, rng.fork(static_cast<std::uint64_t>(i)));
    }
  }

  const TownOptions& options_;
  Rng rng_;
  Index day_;
  Town town_;
  std::vector<Street> streets_;
  double building_line_;  ///< middle of the road to the houses, metres
  std::vector<Plot> plots_;
};

}  // namespace

Town make_town(const TownOptions& options, const Rng& rng, Index day) { return Builder(options, rng, day).build(); }

}  // namespace chainslam::simulator
