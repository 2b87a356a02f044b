#pragma once

#include "chainslam/core/random.hpp"
#include "simulator/lane_path.hpp"
#include "simulator/street_grid.hpp"
#include "simulator/terrain.hpp"
#include "simulator/world.hpp"

namespace chainslam::simulator {

/// How large houses are and how they stand, metres.
struct HouseOptions {
  double least_width = 8.0, most_width = 18.0;  ///< along the street
  double least_depth = 8.0, most_depth = 13.0;
  double at_the_street = 0.3;  ///< part of them that stands right at the pavement
  double most_setback = 4.0;   ///< of the others
};

/// What a street may lead through.
enum class PassageKind {
  corridor,  ///< of a building: 3.4 m wide, 2.8 m high, doors on both sides; vehicles keep to its middle
  tunnel,    ///< as wide as the road, 5.6 m high, plain walls
  open       ///< as on a long bridge: railings along the kerbs, and 40 m to either side nothing but the ground
};

struct Passage {
  Crossing from;  ///< neighbours
  Crossing to;
  PassageKind kind;
  double begin = 0.2;  ///< as parts of the street's length
  double end = 0.8;
};

struct TownOptions {
  StreetOptions streets;
  double steepness = 0.03;      ///< mean slope of each of the terrain's waves
  double ground_spacing = 0.5;  ///< metres between the ground's samples
  double border = 25.0;         ///< ground beyond the outermost crossings, metres
  Index max_storeys = 5;
  double clear_of_crossing = 12.0;  ///< nothing is parked or planted nearer to a crossing, metres
  double parked = 0.45;             ///< part of the kerb's parking bays that are taken
  double parked_anew = 0.6;         ///< part of the bays that are left and taken anew every day
  double kerb_changes = 0.1;        ///< part of what stands along the kerb that is something else every day
  HouseOptions houses;
  double built = 0.8;         ///< part of the plots that are houses; the others are gardens
  double open_sides = 0.0;    ///< part of the streets' sides without houses or gardens: lawns
  double alike = 0.0;         ///< part of the streets' sides where all houses are the same
  double scaffolds = 0.0;     ///< part of the houses that have scaffolding before them on half of all days
  double built_later = 0.0;   ///< part of the houses that are finished only on some day of the first 200
  bool seasons = false;       ///< from November to March trees are bare, and snow lies heaped along the kerb
  double area_per_tree = 80;  ///< of what is tried between the houses, square metres
  std::vector<Passage> passages{};
};

/// A town and the plan it was built from.
struct Town {
  StreetGrid streets;
  Terrain terrain;  ///< the road's surface; pavements and gardens lie a kerb's height above
  World world;
  std::vector<NarrowStretch> narrow;  ///< where the lanes run close together
};

/// Builds streets in an irregular grid over hilly ground, lined with houses, gardens, fences, trees, lamps, signs and
/// parked cars. The same options and generator give the same town; the `day` decides on some of the cars and of what
/// stands along the kerb.
[[nodiscard]] Town make_town(const TownOptions& options, const Rng& rng, Index day = 0);

}  // namespace chainslam::simulator
