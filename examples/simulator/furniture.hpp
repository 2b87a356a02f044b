#pragma once

#include "chainslam/core/random.hpp"
#include "simulator/place.hpp"

namespace chainslam::simulator {

// Things that stand in streets and gardens. Each stands on the origin of `place`, x along the street, y to the left of
// x.

/// A parked car, about 4.3 x 1.8 x 1.5 m, its middle at the origin.
void add_car(World& world, const Place& place, Rng rng);

/// A trunk and a crown of overlapping ellipsoids, or only limbs where a `bare` tree's leaves would be. `size` scales
/// it; 1 is a street tree of about 7 m.
void add_tree(World& world, const Place& place, double size, Rng rng, bool bare = false);

/// A heap of snow along the kerb.
void add_heap(World& world, const Place& place, Rng rng);

/// Poles, boards and braces before a wall, from x = -half to half, up to `height`; the wall is at y = 0, behind.
void add_scaffold(World& world, const Place& place, double half, double height);

/// A lamp of 5 to 7 m with an arm over the road (to +y).
void add_lamp(World& world, const Place& place, Rng rng);

/// A traffic sign on a thin pole.
void add_sign(World& world, const Place& place, Rng rng);

/// A row of bollards along x.
void add_bollards(World& world, const Place& place, Rng rng);

/// A cabinet, bin or bench.
void add_street_box(World& world, const Place& place, Rng rng);

/// A bus shelter of 3.6 x 1.4 x 2.4 m, open to +y.
void add_shelter(World& world, const Place& place, Rng rng);

/// What a fence is made of.
enum class FenceKind { pickets, wall, hedge };

/// One straight piece of fence along x, from the origin to `length`; x may be inclined.
void add_fence(World& world, const Place& place, double length, FenceKind kind, Rng rng);

}  // namespace chainslam::simulator
