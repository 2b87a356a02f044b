#pragma once

#include <optional>

#include "chainslam/core/random.hpp"
#include "simulator/lidar_options.hpp"
#include "simulator/ray_caster.hpp"

namespace chainslam::simulator {

/// Part of the light that a material sends back diffusely.
[[nodiscard]] double reflectivity(Material material);

/// One ray on its way to what it first meets.
struct RayOnTheWay {
  Ray ray;
  double time;  ///< since the drive's start, seconds
};

/// What weather and glass make of what a ray meets: an echo from a drop before it, leaves that sway, what is mirrored.
/// Nothing of it is drawn, and `hit` is returned, where the options have none of that.
[[nodiscard]] std::optional<RayHit> through_weather(const LidarOptions& options, const RayCaster& world,
                                                    const RayOnTheWay& way, std::optional<RayHit> hit, Rng& rng);

/// A surface and how it is met.
struct Echo {
  Material material;
  double range;           ///< true, along the ray, metres
  double cosine;          ///< of the incidence
  double laser_bias;      ///< metres
  double range_of_tenth;  ///< see `LidarModel`
};

/// A range as measured, metres, or nothing if the return was lost.
[[nodiscard]] std::optional<double> measure(const LidarOptions& options, const Echo& echo, Rng& rng);

/// What a spot that lies across an edge in depth reports: if the edge is as short as the pulse, something in between.
///
/// An edge between this firing and the one before lies in the spot as often as the spot is wide, measured in firings.
/// @param before    the range in the firing before. @param expected  ... if the surface went on as it is here.
[[nodiscard]] double spread_over_edge(const LidarOptions& options, double range, double before, double expected,
                                      Rng& rng);

}  // namespace chainslam::simulator
