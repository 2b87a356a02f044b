#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <vector>

#include "simulator/street_grid.hpp"

namespace chainslam::simulator {

/// The line that a vehicle follows in its lane, sampled every 0.1 m, corners rounded.
struct LanePath {
  std::vector<Eigen::Vector2d> positions;  ///< metres
  std::vector<double> distances;           ///< along the path, metres, from 0
  std::vector<double> headings;            ///< direction of travel, radians from x, without jumps
  std::vector<double> curvatures;          ///< 1 / m, positive to the left

  [[nodiscard]] double length() const { return distances.back(); }
};

/// Where on the path a distance lies: a sample and the way to the next, 0 to 1.
struct PathPoint {
  std::size_t index;
  double part;

  PathPoint(const LanePath& path, double distance) {
    const auto above = std::ranges::upper_bound(path.distances, distance);
    const auto position = static_cast<std::size_t>(above - path.distances.begin());
    index = std::clamp<std::size_t>(position, 1, path.distances.size() - 1) - 1;
    part =
        std::clamp((distance - path.distances[index]) / (path.distances[index + 1] - path.distances[index]), 0.0, 1.0);
  }

  template <class T>
  [[nodiscard]] T of(const std::vector<T>& values) const {
    return values[index] + part * (values[index + 1] - values[index]);
  }
};

/// Of the arcs that round corners, metres.
struct CornerRadii {
  double left = 10.0;
  double right = 6.5;
  double bend = 45.0;  ///< where a street turns by less than 0.4 radians
};

/// A stretch of street where vehicles keep nearer to the middle, and the way to it on both sides.
struct NarrowStretch {
  Eigen::Vector2d from;
  Eigen::Vector2d to;
  double reach;  ///< to each side of the line, metres: elsewhere is not meant
};

struct LaneOptions {
  double lane = 1.7;  ///< right of the street's middle, metres
  CornerRadii radii{};
  std::vector<NarrowStretch> narrow{};
};

/// Drives through the crossings in order, to the right of the street's middle; from the middle of the first street to
/// the middle of the last.
/// @throws std::invalid_argument with fewer than three crossings, or where the route turns back on itself.
[[nodiscard]] LanePath follow_lane(const StreetGrid& streets, const Route& route, const LaneOptions& options);

}  // namespace chainslam::simulator
