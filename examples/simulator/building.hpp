#pragma once

#include "chainslam/core/random.hpp"
#include "chainslam/core/types.hpp"
#include "simulator/place.hpp"

namespace chainslam::simulator {

/// A house as its plot and height; all else is drawn.
struct BuildingPlan {
  Place place;        ///< middle of the front wall at street level: x along the street, y into the house, z up
  double width;       ///< along the street, metres
  double depth;       ///< metres
  double foundation;  ///< how far the walls reach below street level, metres
  Index storeys;
};

/// Builds a house with facade relief: windows set back between piers and bands, ledges, a doorway, balconies, and a
/// parapet or a gable roof with chimneys.
void add_building(World& world, const BuildingPlan& plan, Rng rng);

}  // namespace chainslam::simulator
