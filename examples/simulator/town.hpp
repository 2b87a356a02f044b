#pragma once

#include "chainslam/core/random.hpp"
#include "simulator/street_grid.hpp"
#include "simulator/terrain.hpp"
#include "simulator/world.hpp"

namespace chainslam::simulator {

struct TownOptions {
  StreetOptions streets;
  double steepness = 0.03;      ///< mean slope of each of the terrain's waves
  double ground_spacing = 0.5;  ///< metres between the ground's samples
  double border = 25.0;         ///< ground beyond the outermost crossings, metres
  Index max_storeys = 5;
  double parked = 0.45;       ///< part of the kerb's parking bays that are taken
  double parked_anew = 0.6;   ///< part of the bays that are left and taken anew every day
  double kerb_changes = 0.1;  ///< part of what stands along the kerb that is something else every day
};

/// A town and the plan it was built from.
struct Town {
  StreetGrid streets;
  Terrain terrain;  ///< the road's surface; pavements and gardens lie a kerb's height above
  World world;
};

/// Builds streets in an irregular grid over hilly ground, lined with houses, gardens, fences, trees, lamps, signs and
/// parked cars. The same options and generator give the same town; the `day` decides on some of the cars and of what
/// stands along the kerb.
[[nodiscard]] Town make_town(const TownOptions& options, const Rng& rng, Index day = 0);

}  // namespace chainslam::simulator
