#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <utility>
#include <vector>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/types.hpp"
#include "surface_planes.hpp"

namespace chainslam {

/// How keypoints are found above a plane. Defaults: LAMM's configuration for NCLT.
struct BinaryKeypointOptions {
  double cell_size = 0.5;           ///< metres, of the grid in the plane
  double bin_height = 0.1;          ///< metres
  double max_height = 5.0;          ///< metres from the plane, on either side; at most 64 bins
  Index block = 5;                  ///< cells along the side of a block, of which one cell at most is kept
  Index min_occupied = 10;          ///< bins
  double suppression_radius = 1.0;  ///< metres
  Index max_count = 500;
};

/// A place in the plane above which more heights are occupied than around it: a pole, a corner, a trunk.
struct BinaryKeypoint {
  Eigen::Vector3f position{0, 0, 0};  ///< in the plane, in the cloud's frame
  std::uint64_t occupancy = 0;        ///< bit i: there are points between i and i + 1 bin heights from the plane

  [[nodiscard]] Index occupied() const { return std::popcount(occupancy); }
};

/// Dice's coefficient of two occupancies: 1 if they are equal, 0 if they have nothing in common.
[[nodiscard]] inline double similarity(const BinaryKeypoint& a, const BinaryKeypoint& b) {
  const int all = a.occupied() + b.occupied();
  return all > 0 ? 2.0 * std::popcount(a.occupancy & b.occupancy) / all : 0.0;
}

namespace detail {

/// The heights of a cloud above a plane, on a grid in it.
class OccupancyGrid {
 public:
  struct Column {
    Cell cell{};
    std::uint64_t occupancy = 0;
    Eigen::Vector2d sum = Eigen::Vector2d::Zero();  ///< of the points' coordinates in the plane, metres
    Index points = 0;

    [[nodiscard]] Index occupied() const { return std::popcount(occupancy); }
  };

  OccupancyGrid(const PointCloud<float>& cloud, const SurfacePlane& plane, const BinaryKeypointOptions& options)
      : origin_(plane.center),
        first_axis_(plane.normal.unitOrthogonal()),
        second_axis_(plane.normal.cross(first_axis_)) {
    const auto bins = static_cast<int>(std::lround(options.max_height / options.bin_height));
    if (bins < 1 || bins > 64)
      throw std::invalid_argument("BinaryKeypointOptions: 1 to 64 bins, max_height over bin_height");
    for (const Eigen::Vector3f& point : cloud.positions) {
      const Eigen::Vector3d p = point.cast<double>();
      if (!is_finite(p)) continue;
      const double height = plane.distance(p);
      const auto bin = static_cast<int>(height / options.bin_height);
      if (!(height < options.max_height) || bin >= bins) continue;
      add({first_axis_.dot(p - origin_), second_axis_.dot(p - origin_)}, bin, options.cell_size);
    }
  }

  [[nodiscard]] const std::vector<Column>& columns() const { return columns_; }

  [[nodiscard]] Index occupied(std::int32_t x, std::int32_t y) const {
    const Index column = table_.find({x, y, 0});
    return column < 0 ? 0 : columns_[static_cast<std::size_t>(column)].occupied();
  }

  /// The mean of a column's points, moved to the plane.
  [[nodiscard]] Eigen::Vector3d foot(const Column& column) const {
    const Eigen::Vector2d mean = column.sum / static_cast<double>(column.points);
    return origin_ + mean.x() * first_axis_ + mean.y() * second_axis_;
  }

 private:
  void add(const Eigen::Vector2d& p, int bin, double cell_size) {
    const auto cell = cell_of(Eigen::Vector3d(p.x() / cell_size, p.y() / cell_size, 0));
    if (!cell) return;
    const auto [index, is_new] = table_.insert(*cell, to_index(columns_.size()));
    if (is_new) columns_.push_back({.cell = *cell});
    Column& column = columns_[static_cast<std::size_t>(index)];
    column.occupancy |= std::uint64_t{1} << bin;
    column.sum += p;
    ++column.points;
  }

  Eigen::Vector3d origin_, first_axis_, second_axis_;
  CellTable table_;
  std::vector<Column> columns_;
};

/// The column of each block with most occupied bins, those with enough of them; of equals the one with the least cell,
/// so that the order of points does not matter.
[[nodiscard]] inline std::vector<OccupancyGrid::Column> best_of_blocks(const OccupancyGrid& grid,
                                                                       const BinaryKeypointOptions& options) {
  const auto rank = [](const OccupancyGrid::Column& column) {
    return std::make_tuple(-column.occupied(), column.cell.y, column.cell.x);
  };
  const auto block_of = [&](std::int32_t cell) {
    return static_cast<std::int32_t>(std::floor(static_cast<double>(cell) / options.block));
  };
  CellTable blocks;
  std::vector<OccupancyGrid::Column> best;
  for (const OccupancyGrid::Column& column : grid.columns()) {
    if (column.occupied() < options.min_occupied) continue;
    const Cell block{block_of(column.cell.x), block_of(column.cell.y), 0};
    const auto [index, is_new] = blocks.insert(block, to_index(best.size()));
    if (is_new)
      best.push_back(column);
    else if (OccupancyGrid::Column& other = best[static_cast<std::size_t>(index)]; rank(column) < rank(other))
      other = column;
  }
  std::ranges::sort(best, {}, rank);
  return best;
}

/// Whether a column stands on a ridge, such as a wall: on a line through it, one neighbour is about as high, and the
/// other at least half as high. Where along the ridge the keypoint comes to lie is chance.
[[nodiscard]] inline bool is_on_ridge(const OccupancyGrid& grid, const OccupancyGrid::Column& column) {
  constexpr Index about_as_high = 3;  // bins fewer
  constexpr std::array<std::pair<int, int>, 4> directions{{{0, 1}, {1, 0}, {1, 1}, {1, -1}}};
  const Index here = column.occupied();
  return std::ranges::any_of(directions, [&](const auto& direction) {
    const auto [dx, dy] = direction;
    const Index ahead = grid.occupied(column.cell.x + dx, column.cell.y + dy);
    const Index behind = grid.occupied(column.cell.x - dx, column.cell.y - dy);
    return std::max(ahead, behind) >= here - about_as_high && 2 * std::min(ahead, behind) >= here;
  });
}

/// Keypoints that have more occupied bins than all others within the radius. Equals suppress each other: neither is
/// sure to be found again.
[[nodiscard]] inline std::vector<BinaryKeypoint> without_suppressed(const std::vector<BinaryKeypoint>& keypoints,
                                                                    double radius) {
  std::vector<BinaryKeypoint> kept;
  for (std::size_t i = 0; i < keypoints.size(); ++i) {
    bool suppressed = false;
    for (std::size_t j = 0; j < keypoints.size() && !suppressed; ++j)
      suppressed = i != j && keypoints[j].occupied() >= keypoints[i].occupied() &&
                   (keypoints[j].position - keypoints[i].position).norm() < static_cast<float>(radius);
    if (!suppressed) kept.push_back(keypoints[i]);
  }
  return kept;
}

}  // namespace detail

/// The keypoints of a cloud above a plane (Yuan et al. 2024, BTC; Wei et al. 2025, LAMM), those with most occupied bins
/// first. The order of points makes no difference.
/// @param cloud  metres, dense enough that poles fill their bins: several scans put together.
/// @param plane  of the same frame, most often the ground.
[[nodiscard]] inline std::vector<BinaryKeypoint> binary_keypoints(const PointCloud<float>& cloud,
                                                                  const SurfacePlane& plane,
                                                                  const BinaryKeypointOptions& options = {}) {
  const detail::OccupancyGrid grid(cloud, plane, options);
  std::vector<BinaryKeypoint> keypoints;
  for (const detail::OccupancyGrid::Column& column : detail::best_of_blocks(grid, options))
    if (!detail::is_on_ridge(grid, column))
      keypoints.push_back({.position = grid.foot(column).cast<float>(), .occupancy = column.occupancy});
  keypoints = detail::without_suppressed(keypoints, options.suppression_radius);
  if (to_index(keypoints.size()) > options.max_count) keypoints.resize(static_cast<std::size_t>(options.max_count));
  return keypoints;
}

}  // namespace chainslam
