#pragma once

#include <Eigen/Core>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::simulator {

/// How the streets lie.
struct StreetOptions {
  Index columns = 6;          ///< crossings from west to east
  Index rows = 5;             ///< crossings from south to north
  double block = 60.0;        ///< mean distance of crossings, metres
  double irregularity = 0.2;  ///< spread of that distance, as a part of it
  double jitter = 4.0;        ///< displacement of single crossings, metres: no two streets are parallel
  double half_road = 5.0;     ///< middle of the road to the kerb, metres
  double pavement = 2.5;      ///< width of the pavement, metres
};

/// Names a crossing by its place in the grid.
struct Crossing {
  Index column;
  Index row;
};

/// Neighbouring crossings, one after the other.
using Route = std::vector<Crossing>;

/// A straight piece of street between two neighbouring crossings.
struct Street {
  Eigen::Vector2d from;
  Eigen::Vector2d to;
};

/// The town's crossings and the streets between neighbours. World frame, metres, the middle of the town near (0, 0).
class StreetGrid {
 public:
  StreetGrid(const StreetOptions& options, Rng rng);

  [[nodiscard]] const StreetOptions& options() const { return options_; }
  /// @throws std::invalid_argument if there is no such crossing.
  [[nodiscard]] Eigen::Vector2d position(Crossing crossing) const;
  [[nodiscard]] std::vector<Street> streets() const;

 private:
  StreetOptions options_;
  std::vector<Eigen::Vector2d> crossings_;  ///< row by row
};

}  // namespace chainslam::simulator
