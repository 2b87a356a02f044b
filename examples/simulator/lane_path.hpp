#pragma once

#include <Eigen/Core>
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

/// Drives through the crossings in order, `lane` metres to the right of the street's middle; from the middle of the
/// first street to the middle of the last.
/// @throws std::invalid_argument with fewer than three crossings, or where the route turns back on itself.
[[nodiscard]] LanePath follow_lane(const StreetGrid& streets, const Route& route, double lane);

}  // namespace chainslam::simulator
