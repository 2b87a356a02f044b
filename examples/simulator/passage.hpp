#pragma once

#include "chainslam/core/random.hpp"
#include "simulator/place.hpp"
#include "simulator/town.hpp"

namespace chainslam::simulator {

constexpr double passage_piece = 4.0;  ///< metres

/// Half the clear width, metres.
[[nodiscard]] double half_width(PassageKind kind, const StreetOptions& streets);

/// One piece along x from the origin, on the middle of the floor: walls, ceiling, and what is on the walls; of an open
/// stretch the railings.
void add_passage_piece(World& world, const Place& place, PassageKind kind, const StreetOptions& streets, Rng rng);

}  // namespace chainslam::simulator
