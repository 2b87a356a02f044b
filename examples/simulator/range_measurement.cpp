#include "simulator/range_measurement.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace chainslam::simulator {

namespace {

/// Chance that a return is strong enough to be seen: a diffuse surface of reflectivity 0.1, met squarely at
/// `range_of_tenth`, has an even chance; power falls with the square of the distance (radar equation for extended
/// targets).
double chance_of_return(double light, double range, double range_of_tenth) {
  const double power = light / 0.1 * (range_of_tenth / range) * (range_of_tenth / range);
  if (power > 60.0) return 1.0;  // to the last bit
  return 1.0 - std::exp(-std::numbers::ln2 * power);
}

/// Gusts move neighbouring leaves together: two slow waves over the place.
Eigen::Vector3f sway(double amplitude, const Eigen::Vector3f& place, double time) {
  constexpr double slow = 2.0 * std::numbers::pi * 0.31;  // rad/s
  constexpr double fast = 2.0 * std::numbers::pi * 0.47;
  const double along = 0.8 * static_cast<double>(place.x()) + 0.6 * static_cast<double>(place.y());
  const double across = 0.7 * static_cast<double>(place.y()) - 0.5 * static_cast<double>(place.x());
  return {static_cast<float>(amplitude * std::sin(slow * time + along)),
          static_cast<float>(amplitude * std::sin(fast * time + across)), 0.0F};
}

/// Where a drop echoes before what the ray meets, if one does. Echoes of drops are weak: they come from near.
std::optional<RayHit> echo_of_drop(const LidarOptions& options, const Ray& ray, double free_way, Rng& rng) {
  constexpr double reach = 20.0;  // metres
  const double distance = -std::log(1.0 - rng.uniform()) / options.drops;
  if (distance > std::min(free_way, reach) || rng.uniform() < distance / reach) return std::nullopt;
  return RayHit{static_cast<float>(distance), -ray.direction, Material::pavement, Presence::moving};
}

/// What is seen in a pane; it seems to lie behind it.
std::optional<RayHit> mirrored(const RayCaster& world, const Ray& ray, const RayHit& pane) {
  constexpr float off_the_pane = 0.01F;  // metres
  const Eigen::Vector3f direction = ray.direction - 2.0F * pane.normal.dot(ray.direction) * pane.normal;
  auto seen = world.cast({.origin = ray.origin + pane.distance * ray.direction + off_the_pane * pane.normal,
                          .direction = direction,
                          .max_distance = ray.max_distance - pane.distance});
  if (!seen) return std::nullopt;
  // As the sensor meets it: with the incidence of the mirrored ray.
  const float cosine = seen->normal.dot(direction);
  return RayHit{pane.distance + seen->distance, cosine * ray.direction, seen->material, Presence::moving};
}

}  // namespace

double reflectivity(Material material) {
  constexpr std::array<double, 10> parts{0.15, 0.25, 0.3, 0.4, 0.06, 0.35, 0.3, 0.35, 0.45, 0.4};
  return parts[static_cast<std::size_t>(material)];
}

std::optional<RayHit> through_weather(const LidarOptions& options, const RayCaster& world, const RayOnTheWay& way,
                                      std::optional<RayHit> hit, Rng& rng) {
  const Ray& ray = way.ray;
  if (options.drops > 0.0) {
    const double free_way = hit ? static_cast<double>(hit->distance) : options.max_range;
    if (auto drop = echo_of_drop(options, ray, free_way, rng)) return drop;
  }
  if (!hit) return hit;
  if (options.mirrored > 0.0 && hit->material == Material::glass && rng.uniform() < options.mirrored)
    return mirrored(world, ray, *hit);
  if (options.wind > 0.0 && hit->material == Material::foliage) {
    const Eigen::Vector3f place = ray.origin + hit->distance * ray.direction;
    hit->distance += sway(options.wind, place, way.time).dot(ray.direction);
  }
  return hit;
}

std::optional<double> measure(const LidarOptions& options, const Echo& echo, Rng& rng) {
  double light = reflectivity(echo.material) * echo.cosine;
  if (options.dimming > 0.0) light *= std::exp(-2.0 * options.dimming * echo.range);
  if (rng.uniform() < options.lost_returns) return std::nullopt;
  if (rng.uniform() > chance_of_return(light, echo.range, echo.range_of_tenth)) return std::nullopt;
  double measured = echo.range + echo.laser_bias + options.range_noise * rng.normal();
  measured += options.incidence_bias * std::min(10.0, 1.0 / echo.cosine - 1.0);
  measured += options.intensity_bias * std::max(0.0, 1.0 - 2.0 * light);
  if (echo.material == Material::foliage) measured -= 0.12 * std::log(1.0 - rng.uniform());  // into the leaves
  if (measured < options.min_range || measured > options.max_range) return std::nullopt;
  return measured;
}

double spread_over_edge(const LidarOptions& options, double range, double before, double expected, Rng& rng) {
  constexpr double pulse = 1.0;  // metres
  constexpr double least = 0.1;  // metres: less is no edge
  const double jump = std::abs(before - expected);
  if (!(jump > least && jump < pulse)) return range;
  const double spot = options.beam_width_deg * options.firings_per_revolution / 360.0;
  return rng.uniform() < spot ? range + rng.uniform() * (before - expected) : range;
}

}  // namespace chainslam::simulator
