#pragma once

#include <Eigen/Core>
#include <array>

#include "chainslam/core/random.hpp"

namespace chainslam::simulator {

/// Smooth relief without end: a sum of plane waves with random directions, lengths of 90 to 260 m and phases.
///
/// Heights and slopes are closed forms, so that the ground's grid and the vehicle's path agree exactly.
class Terrain {
 public:
  /// @param steepness  mean slope of each wave, rise over run; 0.03 gives hills of some metres and streets of up to 10
  /// %.
  Terrain(double steepness, Rng rng);

  /// z at (x, y), metres.
  [[nodiscard]] double height(const Eigen::Vector2d& position) const;
  /// (dz/dx, dz/dy) at (x, y).
  [[nodiscard]] Eigen::Vector2d slope(const Eigen::Vector2d& position) const;

 private:
  struct Wave {
    Eigen::Vector2d number;  ///< radians per metre
    double phase;            ///< radians
    double amplitude;        ///< metres
  };
  std::array<Wave, 6> waves_;
};

}  // namespace chainslam::simulator
