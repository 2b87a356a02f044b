#include "chainslam/slam/occupancy_grid.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <set>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/core/random.hpp"

namespace {

using namespace chainslam;

constexpr double sensor_height = 1.0;

/// A room of 8 x 6 m with a pillar: what a ray hits first. Its walls are in the middle of cells.
struct Room {
  static constexpr double begin = 0.05, length = 8.05, width = 6.05;
  Eigen::Vector2d pillar{5.05, 2.05};  ///< its corner with the smallest x and y; it is 0.5 m wide
  double tilt = 0;                     ///< the whole room rises by so much along x

  [[nodiscard]] double ground(double x) const { return tilt * x; }

  /// @param direction  of unit length
  [[nodiscard]] Eigen::Vector3d first_return(const Eigen::Vector3d& from, const Eigen::Vector3d& direction) const {
    double nearest = 100;
    const auto at = [&](double t) { return Eigen::Vector3d(from + t * direction); };
    const auto consider = [&](double t) {
      if (t > 1e-9 && t < nearest) nearest = t;
    };
    // The floor and a ceiling 4 m above it.
    const double climb = direction.z() - tilt * direction.x();
    const double above = from.z() - ground(from.x());
    consider(-above / climb);
    consider((4 - above) / climb);
    for (const double wall : {begin, length}) consider((wall - from.x()) / direction.x());
    for (const double wall : {begin, width}) consider((wall - from.y()) / direction.y());
    for (int k = 0; k < 2; ++k)
      for (const double side : {pillar[k], pillar[k] + 0.5}) {
        const double t = (side - from[k]) / direction[k];
        const double other = at(t)[1 - k] - pillar[1 - k];
        if (other >= 0 && other <= 0.5) consider(t);
      }
    return at(nearest);
  }
};

/// A map of the room, from some places in it. The body of each keyframe is turned by another angle.
SlamMap mapped(const Room& room, Rng& rng, int keyframes, int rays) {
  SlamMap map;
  map.sessions.push_back({.id = SessionId{0}, .keyframes = keyframes, .frame = SessionId{0}});
  for (int i = 0; i < keyframes; ++i) {
    Keyframe keyframe{.id = KeyframeId{i}, .session = SessionId{0}, .time = Timestamp::from_seconds(i)};
    const double x = rng.uniform(0.5, 4.5);
    keyframe.T_map_body =
        SE3d(SO3d::exp({0, 0, rng.uniform(-3, 3)}), {x, rng.uniform(0.5, 5.5), room.ground(x) + sensor_height});
    auto cloud = std::make_shared<PointCloud<float>>();
    for (int k = 0; k < rays; ++k) {
      const Eigen::Vector3d direction = Eigen::Vector3d(rng.normal(), rng.normal(), rng.normal(0, 0.4)).normalized();
      const Eigen::Vector3d point = room.first_return(keyframe.T_map_body.translation(), direction);
      cloud->positions.push_back((keyframe.T_map_body.inverse() * point).cast<float>());
    }
    keyframe.cloud = cloud;
    map.keyframes.push_back(keyframe);
  }
  return map;
}

const std::vector<SessionId> first_session{SessionId{0}};

/// The share of a line between two points that lies in a cell: from where to where; nothing if it misses the cell.
std::pair<double, double> share_in(const Eigen::Vector2d& from, const Eigen::Vector2d& to, const Eigen::Vector2d& lower,
                                   double edge) {
  double enter = 0, leave = 1;
  for (int k = 0; k < 2; ++k) {
    const double a = (lower[k] - from[k]) / (to[k] - from[k]), b = (lower[k] + edge - from[k]) / (to[k] - from[k]);
    enter = std::max(enter, std::min(a, b));
    leave = std::min(leave, std::max(a, b));
  }
  return {enter, leave};
}

}  // namespace

TEST_SUITE("map/occupancy_grid") {
  TEST_CASE("a line passes the cells that it crosses, in order, and no others") {
    Rng rng(1);
    for (int round = 0; round < 2000; ++round) {
      const Eigen::Vector2d from(rng.uniform(0, 12), rng.uniform(0, 12)), to(rng.uniform(0, 12), rng.uniform(0, 12));
      std::set<std::pair<Index, Index>> found;
      double before = 0;
      detail::for_each_cell_between(from, to, [&](Index x, Index y, double share) {
        CHECK(found.emplace(x, y).second);
        const auto [enter, leave] = share_in(from, to, Eigen::Vector2d(x, y), 1);
        CHECK(share == doctest::Approx((enter + leave) / 2));
        CHECK(share >= before);
        before = share;
      });
      std::set<std::pair<Index, Index>> expected;
      for (Index x = 0; x < 12; ++x)
        for (Index y = 0; y < 12; ++y)
          if (const auto [enter, leave] = share_in(from, to, Eigen::Vector2d(x, y), 1); enter < leave)
            expected.emplace(x, y);
      expected.erase({static_cast<Index>(to.x()), static_cast<Index>(to.y())});
      CHECK(found == expected);
    }
    // Along an axis, on the edges of cells, and to where it begins.
    int cells = 0;
    const auto count = [&](Index, Index, double) { ++cells; };
    detail::for_each_cell_between({2, 3}, {7, 3}, count);
    CHECK(cells == 5);
    detail::for_each_cell_between({7, 7}, {2, 2}, count);
    CHECK(cells == 5 + 10);
    detail::for_each_cell_between({7.5, 7.5}, {7.5, 7.5}, count);
    CHECK(cells == 15);
  }

  TEST_CASE("the ground rises no steeper than it may from any cell's third lowest point") {
    Rng rng(2);
    for (int round = 0; round < 20; ++round) {
      constexpr int size = 12;
      const double slope = rng.uniform(0.05, 1), cell = 0.5;
      GroundHeights ground({0, 0}, {size * cell - 0.1, size * cell - 0.1}, cell, slope);
      std::vector<std::vector<double>> heights(size * size);
      for (int i = 0; i < 150; ++i) {
        const Eigen::Vector3d point(rng.uniform(0, size * cell - 0.1), rng.uniform(0, size * cell - 0.1),
                                    rng.normal(0, 2));
        ground.add(point);
        heights[static_cast<std::size_t>(point.y() / cell) * size + static_cast<std::size_t>(point.x() / cell)]
            .push_back(point.z());
      }
      ground.settle();
      const auto steps = [](std::size_t a, std::size_t b) {
        return std::abs(static_cast<double>(a) - static_cast<double>(b));
      };
      for (std::size_t i = 0; i < heights.size(); ++i) {
        double expected = 1e9;
        for (std::size_t k = 0; k < heights.size(); ++k) {
          if (heights[k].size() < 3) continue;
          std::nth_element(heights[k].begin(), heights[k].begin() + 2, heights[k].end());
          const double dx = steps(i % size, k % size), dy = steps(i / size, k / size);
          const double distance = std::max(dx, dy) + (std::sqrt(2.0) - 1) * std::min(dx, dy);  // in eight directions
          expected = std::min(expected, heights[k][2] + slope * cell * distance);
        }
        CHECK(ground.at((static_cast<double>(i % size) + 0.5) * cell, (static_cast<double>(i / size) + 0.5) * cell) ==
              doctest::Approx(expected).epsilon(1e-5));
      }
    }
  }

  TEST_CASE("a drawn room: walls are occupied, inside is free, outside and in the pillar nothing is known") {
    for (const double tilt : {0.0, 0.15}) {
      CAPTURE(tilt);
      const Room room{.tilt = tilt};
      Rng rng(3);
      SlamMap map = mapped(room, rng, 40, 4000);
      // Two reflections from far below the floor in the same place.
      auto cloud = std::make_shared<PointCloud<float>>(*map.keyframes[0].cloud.load());
      for (int i = 0; i < 2; ++i)
        cloud->positions.push_back(
            (map.keyframes[0].T_map_body.inverse() * Eigen::Vector3d(3, 3, room.ground(3) - 5)).cast<float>());
      map.keyframes[0].cloud = cloud;
      const OccupancyGrid<> grid = occupancy_grid(map, first_session);
      REQUIRE(grid.width > 80);
      REQUIRE(grid.height > 60);
      int occupied = 0, free = 0, wall = 0, inside = 0, wrong = 0;
      for (Index y = 0; y < grid.height; ++y)
        for (Index x = 0; x < grid.width; ++x) {
          const Eigen::Vector2d middle = grid.origin + grid.resolution * Eigen::Vector2d(x + 0.5, y + 0.5);
          const double to_wall = std::min(
              {middle.x() - room.begin, room.length - middle.x(), middle.y() - room.begin, room.width - middle.y()});
          const Eigen::Array2d in_pillar = (middle - room.pillar).array();
          const double to_pillar = -std::min(in_pillar.minCoeff(), (0.5 - in_pillar).minCoeff());  // < 0: in it
          const double probability = grid.model.probability(grid.at(x, y));
          if (std::abs(to_wall) < 0.04 || (to_wall > 0 && std::abs(to_pillar) < 0.04)) {
            ++wall;
            occupied += probability > 0.65;
          } else if (to_wall < -0.11 || to_pillar < -0.11) {
            wrong += grid.at(x, y) != LogOdds::unknown;
          } else if (to_wall > 0.11 && to_pillar > 0.11) {
            ++inside;
            free += probability < 0.35;
            wrong += probability > 0.65;
          }
        }
      CHECK(wrong == 0);
      CHECK(wall > 100);
      CHECK(occupied >= 0.8 * wall);  // the pillar hides some
      CHECK(free >= 0.97 * inside);
    }
  }

  TEST_CASE("one scan agrees with brute force: cells with a return in the band, cells that rays cross in the band") {
    Rng rng(4);
    const Room room;
    const SlamMap map = mapped(room, rng, 1, 600);
    const OccupancyGridOptions options{.resolution = 0.25, .sensor = {0.1, -0.05, 0.2}, .ground_slope = 0};
    const OccupancyGrid<> grid = occupancy_grid(map, first_session, options);
    const Keyframe& keyframe = map.keyframes.front();
    const Eigen::Vector3d sensor = keyframe.T_map_body * options.sensor;
    std::vector<Eigen::Vector3d> returns;
    for (const Eigen::Vector3f& p : keyframe.cloud.load()->positions)
      returns.push_back(keyframe.T_map_body * p.cast<double>());
    double ground = 1e9;  // without a slope, the lowest of all cells
    std::vector<double> cell_heights;
    GroundHeights heights(Eigen::Vector2d(-1, -1), Eigen::Vector2d(9, 7), options.ground_cell, 0);
    for (const Eigen::Vector3d& point : returns) heights.add(point);
    heights.settle();
    ground = heights.at(3, 3);
    CHECK(std::abs(ground) < 1e-5);
    const auto in_band = [&](double z) { return z - ground >= options.min_height && z - ground <= options.max_height; };
    const LogOdds model;
    int hits = 0, misses = 0, different = 0;
    for (Index y = 0; y < grid.height; ++y)
      for (Index x = 0; x < grid.width; ++x) {
        const Eigen::Vector2d lower = grid.origin + options.resolution * Eigen::Vector2d(x, y);
        bool hit = false, missed = false;
        for (const Eigen::Vector3d& point : returns) {
          const Eigen::Array2d inside = (point.head<2>() - lower).array();
          const bool ends_here = (inside >= 0).all() && (inside < options.resolution).all();
          hit |= ends_here && in_band(point.z());
          const auto [enter, leave] = share_in(sensor.head<2>(), point.head<2>(), lower, options.resolution);
          missed |=
              !ends_here && enter < leave && in_band(sensor.z() + 0.5 * (enter + leave) * (point.z() - sensor.z()));
        }
        const LogOdds::Cell expected = hit      ? model.hit(LogOdds::unknown)
                                       : missed ? model.miss(LogOdds::unknown)
                                                : LogOdds::unknown;
        different += grid.at(x, y) != expected;
        hits += hit;
        misses += missed;
      }
    CHECK(different == 0);
    CHECK(hits > 50);
    CHECK(misses > 300);
  }

  TEST_CASE("evidence adds up within bounds; without returns there is no grid, and a huge one is refused") {
    const LogOdds model;
    LogOdds::Cell cell = LogOdds::unknown;
    CHECK(model.probability(cell) == 0.5);
    cell = model.hit(cell);
    CHECK(model.probability(cell) == doctest::Approx(0.70).epsilon(0.01));
    CHECK(model.probability(model.miss(LogOdds::unknown)) == doctest::Approx(0.40).epsilon(0.01));
    CHECK(model.miss(cell) == 17 - 8);
    for (int i = 0; i < 20; ++i) cell = model.hit(cell);
    CHECK(model.probability(cell) == doctest::Approx(0.97).epsilon(0.01));
    for (int i = 0; i < 20; ++i) cell = model.miss(cell);
    CHECK(model.probability(cell) == doctest::Approx(0.12).epsilon(0.02));

    CHECK(occupancy_grid(SlamMap(), first_session).cells.empty());
    Rng rng(5);
    const SlamMap map = mapped(Room{}, rng, 2, 50);
    CHECK(occupancy_grid(map, std::vector{SessionId{1}}).cells.empty());
    CHECK(occupancy_grid(map, first_session, {.max_range = 0.01}).cells.empty());
    CHECK_THROWS_AS(static_cast<void>(occupancy_grid(map, first_session, {.max_cells = 100})), std::length_error);
  }
}
