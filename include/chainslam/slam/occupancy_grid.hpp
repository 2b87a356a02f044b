#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numbers>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/slam/detail/grid_ray.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam {

/// Heights of the ground over the xy-plane, from points of which the lowest lie on it.
///
/// A cell's own height is that of its third lowest point: two may be reflections from below. The ground rises by at
/// most `slope` from cell to cell, so that cells with walls or treetops alone, and cells without points, take theirs
/// from around. Of floors one above the other it is the lowest.
class GroundHeights {
 public:
  /// An empty rectangle. @param lower  its corner with the smallest x and y, metres.
  GroundHeights(const Eigen::Vector2d& lower, const Eigen::Vector2d& upper, double cell, double slope)
      : lower_(lower),
        cell_(cell),
        slope_(slope),
        width_(static_cast<std::size_t>((upper.x() - lower.x()) / cell) + 1),
        height_(static_cast<std::size_t>((upper.y() - lower.y()) / cell) + 1),
        lowest_(width_ * height_, Lowest{none, none, none}) {}

  /// Takes a point inside of the rectangle.
  void add(const Eigen::Vector3d& point) {
    float z = static_cast<float>(point.z());
    for (float& kept : lowest_[index(point.x(), point.y())])
      if (z < kept) std::swap(z, kept);
  }

  /// To be called once all points are there.
  void settle() {
    heights_.resize(lowest_.size());
    for (std::size_t i = 0; i < lowest_.size(); ++i) heights_[i] = lowest_[i][2];
    lowest_ = {};
    for (std::size_t y = 0; y < height_; ++y)
      for (std::size_t x = 0; x < width_; ++x) bound(x, y, -1);
    for (std::size_t y = height_; y-- > 0;)
      for (std::size_t x = width_; x-- > 0;) bound(x, y, +1);
  }

  /// The ground's height at a place in the rectangle, metres; infinite if no cell has points enough.
  [[nodiscard]] double at(double x, double y) const { return static_cast<double>(heights_[index(x, y)]); }

 private:
  using Lowest = std::array<float, 3>;
  static constexpr float none = std::numeric_limits<float>::infinity();

  [[nodiscard]] std::size_t index(double x, double y) const {
    const auto along = [&](double offset, std::size_t cells) {
      return std::min(static_cast<std::size_t>(std::max(offset / cell_, 0.0)), cells - 1);
    };
    return along(y - lower_.y(), height_) * width_ + along(x - lower_.x(), width_);
  }

  /// Lowers a cell to what its neighbours in the row before (or behind) and the one beside it allow: two passes over
  /// all give the lower envelope, as in the chamfer distance transform (Borgefors 1986).
  void bound(std::size_t x, std::size_t y, int step) {
    float& height = heights_[y * width_ + x];
    const auto by = [&](int dx, int dy) {
      const std::size_t there_x = x + static_cast<std::size_t>(dx), there_y = y + static_cast<std::size_t>(dy);
      if (there_x >= width_ || there_y >= height_) return;  // also what is below 0, which wraps around
      const double rise = slope_ * cell_ * (dx != 0 && dy != 0 ? std::numbers::sqrt2 : 1.0);
      height = std::min(height, heights_[there_y * width_ + there_x] + static_cast<float>(rise));
    };
    by(step, 0);
    for (const int dx : {-1, 0, 1}) by(dx, step);
  }

  Eigen::Vector2d lower_;
  double cell_, slope_;
  std::size_t width_, height_;
  std::vector<Lowest> lowest_;
  std::vector<float> heights_;
};

/// How evidence adds up in a cell of a grid: one value for each cell, `unknown` at first.
template <class M>
concept OccupancyModel = requires(const M& model, typename M::Cell cell) {
  { M::unknown } -> std::convertible_to<typename M::Cell>;
  { model.hit(cell) } -> std::same_as<typename M::Cell>;
  { model.miss(cell) } -> std::same_as<typename M::Cell>;
  { model.probability(cell) } -> std::convertible_to<double>;
};

/// Log-odds in steps of 0.05, with bounds beyond which a cell learns no more (Hornung et al. 2013, OctoMap, whose
/// probabilities these are).
struct LogOdds {
  using Cell = std::int8_t;              ///< steps of 0.05
  static constexpr Cell unknown = -128;  ///< no scan has said anything

  Cell when_hit = 17;     ///< what a return adds: a probability of 0.7
  Cell when_missed = -8;  ///< what a ray through the cell adds: 0.4
  Cell least = -40;       ///< smallest of a cell: 0.12
  Cell most = 70;         ///< largest: 0.97

  [[nodiscard]] Cell hit(Cell cell) const { return moved(cell, when_hit); }      ///< a return was in the cell
  [[nodiscard]] Cell miss(Cell cell) const { return moved(cell, when_missed); }  ///< a ray went through the cell
  /// That the cell is occupied.
  [[nodiscard]] double probability(Cell cell) const {
    return cell == unknown ? 0.5 : 1 / (1 + std::exp(-0.05 * static_cast<double>(cell)));
  }

 private:
  [[nodiscard]] Cell moved(Cell cell, Cell by) const {
    return static_cast<Cell>(std::clamp((cell == unknown ? 0 : cell) + by, int{least}, int{most}));
  }
};
static_assert(OccupancyModel<LogOdds>);

/// What of a map becomes an occupancy grid. Lengths are metres.
struct OccupancyGridOptions {
  double resolution = 0.1;                               ///< edge of a cell
  double min_height = 0.2;                               ///< above the ground: what is lower is driven over,
  double max_height = 2.0;                               ///< what is higher is driven under
  double max_range = 40;                                 ///< longer rays are not used
  Eigen::Vector3d sensor = Eigen::Vector3d::Zero();      ///< the LiDAR in the body
  double ground_cell = 0.5;                              ///< edge of the cells in which the ground is sought
  double ground_slope = 0.3;                             ///< that it has at most, rise over run
  std::int64_t max_cells = std::int64_t{1'000'000'000};  ///< larger grids are refused
};

/// Cells over the xy-plane of a map's frame, row by row from the smallest y.
template <OccupancyModel Model = LogOdds>
struct OccupancyGrid {
  Eigen::Vector2d origin = Eigen::Vector2d::Zero();  ///< the corner with the smallest x and y, metres
  double resolution = 0.1;                           ///< metres
  Index width = 0;                                   ///< cells along x
  Index height = 0;                                  ///< cells along y
  std::vector<typename Model::Cell> cells{};         ///< width * height
  Model model{};                                     ///< how evidence adds up

  /// The cell in a column and a row.
  [[nodiscard]] typename Model::Cell at(Index x, Index y) const { return cells[index(x, y)]; }
  /// Its place in `cells`.
  [[nodiscard]] std::size_t index(Index x, Index y) const {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + static_cast<std::size_t>(x);
  }
};

namespace detail {

/// The scans of some sessions, placed by the map, without what is too far from the sensor.
template <class Take>
void for_each_placed_scan(const SlamMap& map, std::span<const SessionId> sessions, const OccupancyGridOptions& options,
                          const Take& take) {
  std::vector<Eigen::Vector3d> returns;
  for (const Keyframe& keyframe : map.keyframes) {
    if (!keyframe.cloud || std::find(sessions.begin(), sessions.end(), keyframe.session) == sessions.end()) continue;
    const KeyframeScan::Cloud cloud = keyframe.cloud.load();
    returns.clear();
    for (const Eigen::Vector3f& position : cloud->positions) {
      const Eigen::Vector3d p = position.cast<double>();
      if ((p - options.sensor).norm() <= options.max_range) returns.push_back(keyframe.T_map_body * p);
    }
    take(Eigen::Vector3d(keyframe.T_map_body * options.sensor), std::span<const Eigen::Vector3d>(returns));
  }
}

/// Adds scans to a grid. Each cell learns once from each scan: a return in it counts more than rays through it.
template <class Model>
class GridScans {
 public:
  GridScans(OccupancyGrid<Model>& grid, const GroundHeights& ground, const OccupancyGridOptions& options)
      : grid_(grid), ground_(ground), options_(options), seen_(grid.cells.size(), nothing) {}

  void add(const Eigen::Vector3d& sensor, std::span<const Eigen::Vector3d> returns) {
    const Eigen::Vector2d from = in_cells(sensor);
    for (const Eigen::Vector3d& point : returns) {
      const Eigen::Vector2d to = in_cells(point);
      for_each_cell_between(from, to, [&](Index x, Index y, double share) {
        if (is_in_band(middle(x, y), sensor.z() + share * (point.z() - sensor.z()))) mark(x, y, missed);
      });
      if (is_in_band(point.head<2>(), point.z())) mark(static_cast<Index>(to.x()), static_cast<Index>(to.y()), hit);
    }
    for (const std::size_t i : touched_) {
      grid_.cells[i] = seen_[i] == hit ? grid_.model.hit(grid_.cells[i]) : grid_.model.miss(grid_.cells[i]);
      seen_[i] = nothing;
    }
    touched_.clear();
  }

 private:
  enum Seen : std::uint8_t { nothing, missed, hit };

  [[nodiscard]] Eigen::Vector2d in_cells(const Eigen::Vector3d& point) const {
    return (point.head<2>() - grid_.origin) / grid_.resolution;
  }
  [[nodiscard]] Eigen::Vector2d middle(Index x, Index y) const {
    return grid_.origin + grid_.resolution * Eigen::Vector2d(x + 0.5, y + 0.5);
  }
  [[nodiscard]] bool is_in_band(const Eigen::Vector2d& place, double z) const {
    const double above = z - ground_.at(place.x(), place.y());
    return above >= options_.min_height && above <= options_.max_height;
  }
  void mark(Index x, Index y, Seen what) {
    const std::size_t i = grid_.index(x, y);
    if (seen_[i] == nothing) touched_.push_back(i);
    seen_[i] = std::max(seen_[i], what);
  }

  OccupancyGrid<Model>& grid_;
  const GroundHeights& ground_;
  const OccupancyGridOptions& options_;
  std::vector<Seen> seen_;
  std::vector<std::size_t> touched_;
};

}  // namespace detail

/// What is free and what is occupied between two heights over the local ground, for robots that drive: rays from each
/// keyframe's sensor to its returns free the cells above which they are between these heights, and returns between them
/// occupy theirs. Frames of the map stand upright. Scans are read three times, and none is kept.
/// @param sessions  of one frame
/// @returns an empty grid if there is no return in range.
/// @throws std::length_error if it would have more than `max_cells` cells.
template <OccupancyModel Model = LogOdds>
[[nodiscard]] OccupancyGrid<Model> occupancy_grid(const SlamMap& map, std::span<const SessionId> sessions,
                                                  const OccupancyGridOptions& options = {}, Model model = {}) {
  constexpr double infinite = std::numeric_limits<double>::infinity();
  Eigen::Vector2d lower = Eigen::Vector2d::Constant(infinite), upper = -lower;
  const auto cover = [&](const Eigen::Vector3d& point) {
    lower = lower.cwiseMin(point.head<2>());
    upper = upper.cwiseMax(point.head<2>());
  };
  detail::for_each_placed_scan(map, sessions, options, [&](const Eigen::Vector3d& sensor, const auto& returns) {
    if (!returns.empty()) cover(sensor);
    for (const Eigen::Vector3d& point : returns) cover(point);
  });
  OccupancyGrid<Model> grid{.resolution = options.resolution, .model = std::move(model)};
  if (!(lower.x() <= upper.x())) return grid;
  // On whole cells of the frame, so that grids of one frame fit each other, with an empty cell around.
  grid.origin = ((lower / options.resolution).array().floor() - 1).matrix() * options.resolution;
  const Eigen::Vector2d size = (((upper - grid.origin) / options.resolution).array().floor() + 2).matrix();
  const double ground_cell = std::max(options.ground_cell, options.resolution);
  const double ground_cells = ((upper - lower) / ground_cell).array().ceil().prod();  // each takes 8 times the memory
  if (!(size.prod() <= static_cast<double>(options.max_cells) &&
        8 * ground_cells <= static_cast<double>(options.max_cells)))
    throw std::length_error("occupancy_grid: more than " + std::to_string(options.max_cells) + " cells");
  grid.width = static_cast<Index>(size.x());
  grid.height = static_cast<Index>(size.y());
  grid.cells.assign(static_cast<std::size_t>(grid.width) * static_cast<std::size_t>(grid.height), Model::unknown);
  GroundHeights ground(lower, upper, ground_cell, options.ground_slope);
  detail::for_each_placed_scan(map, sessions, options, [&](const Eigen::Vector3d&, const auto& returns) {
    for (const Eigen::Vector3d& point : returns) ground.add(point);
  });
  ground.settle();
  detail::GridScans<Model> scans(grid, ground, options);
  detail::for_each_placed_scan(map, sessions, options,
                               [&](const Eigen::Vector3d& sensor, const auto& returns) { scans.add(sensor, returns); });
  return grid;
}

}  // namespace chainslam
