#pragma once

#include "chainslam/core/random.hpp"
#include "simulator/driven_path.hpp"
#include "simulator/path_terrain.hpp"
#include "simulator/world.hpp"

namespace chainslam::simulator {

/// What stands along a driven path: the streets of a suburb. Lengths in metres.
struct RoadsideOptions {
  double clearance = 1.6;  ///< from the path to anything, whichever pass: half a car and more
  double least_stretch = 40.0, most_stretch = 160.0;  ///< how far a side of the street keeps its character
  double parked = 0.45;                               ///< part of the parking bays that are taken
  double most_built = 0.85;                           ///< part of the plots with a house, where houses stand densely
  double area_per_tree = 90.0;                        ///< of what is tried behind the houses, square metres
  double depth = 70.0;                                ///< how far from the path anything is built
};

/// Builds the world along a path: houses with gaps and gardens between them, hedges, walls, trees, lamps, signs, parked
/// cars, stretches of lawn and of wood; nothing nearer to any pass of the path than the clearance.
///
/// A side of the street changes its character every hundred metres or so, from rows of houses to open lawn. Streets
/// that are driven again are lined once. The same path and generator give the same world.
[[nodiscard]] World make_roadside(const DrivenPath& path, const PathTerrain& terrain, const RoadsideOptions& options,
                                  const Rng& rng);

}  // namespace chainslam::simulator
