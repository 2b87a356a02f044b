#include "simulator/spinning_lidar.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>
#include <stdexcept>

#include "simulator/day.hpp"
#include "simulator/rig.hpp"

namespace chainslam::simulator {

namespace {

constexpr double degree = std::numbers::pi / 180.0;

/// Part of the light that comes back diffusely, by `Material`.
constexpr std::array<double, 10> reflectivity{0.15, 0.25, 0.3, 0.4, 0.06, 0.35, 0.3, 0.35, 0.45, 0.4};

/// Chance that a return is strong enough to be seen: a diffuse surface of reflectivity 0.1, met squarely at 100 m, has
/// an even chance; power falls with the square of the distance (radar equation for extended targets).
double chance_of_return(double albedo, double cosine, double range) {
  const double power = albedo * cosine / 0.1 * (100.0 / range) * (100.0 / range);
  return 1.0 - std::exp(-std::numbers::ln2 * power);
}

Eigen::Vector3d random_direction(Rng& rng) {
  Eigen::Vector3d direction;
  for (int axis = 0; axis < 3; ++axis) direction[axis] = rng.normal();
  return direction.normalized();
}

Eigen::Vector3d turned(double cosine, double sine, const Eigen::Vector3d& v) {
  return {cosine * v.x() - sine * v.y(), sine * v.x() + cosine * v.y(), v.z()};
}

/// A range as measured, or nothing if the return was lost.
std::optional<double> measure(const LidarOptions& options, const RayHit& hit, double cosine, double bias, Rng& rng) {
  const auto range = static_cast<double>(hit.distance);
  const double albedo = reflectivity[static_cast<std::size_t>(hit.material)];
  if (rng.uniform() < options.lost_returns) return std::nullopt;
  if (rng.uniform() > chance_of_return(albedo, cosine, range)) return std::nullopt;
  double measured = range + bias + options.range_noise * rng.normal();
  measured += options.incidence_bias * std::min(10.0, 1.0 / cosine - 1.0);
  if (hit.material == Material::foliage) measured -= 0.12 * std::log(1.0 - rng.uniform());  // into the leaves
  if (measured < options.min_range || measured > options.max_range) return std::nullopt;
  return measured;
}

}  // namespace

SpinningLidar::SpinningLidar(const LidarOptions& options, Rng unit, Index day)
    : options_(options), noise_(on_day(unit, day)) {
  if (options.firings_per_revolution <= 0 || options.firings_per_revolution % firings_per_packet != 0)
    throw std::invalid_argument("SpinningLidar: firings_per_revolution must be a positive multiple of 12");
  const Eigen::Vector3d axis = random_direction(unit);
  const Eigen::Vector3d shift = random_direction(unit);
  const SE3d nominal = nominal_T_body_lidar();
  true_T_body_lidar_ = SE3d(nominal.rotation() * SO3d::exp(options.mount_angle_deg * degree * axis),
                            nominal.translation() + options.mount_shift * shift);

  const double turn_rate = -2.0 * std::numbers::pi / options.period;
  for (Index laser = 0; laser < lasers; ++laser) {
    const auto sign = [&] { return unit.uniform() < 0.5 ? -1.0 : 1.0; };
    const double error = sign() * unit.uniform(0.2, 1.0) * options.elevation_error_deg * degree;
    const double bias = sign() * unit.uniform(0.5, 1.5) * options.range_bias;
    const double azimuth = turn_rate * to_seconds(laser_offset(laser));
    const auto direction = [&](double elevation) {
      return Eigen::Vector3d(std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth),
                             std::sin(elevation));
    };
    const double elevation = nominal_elevation(laser);
    lasers_.push_back({.nominal = direction(elevation), .actual = direction(elevation + error), .range_bias = bias});
  }
}

double SpinningLidar::nominal_elevation(Index laser) {
  // Even lasers from the lowest up, odd ones from the middle up (HDL-32E user's manual).
  constexpr double spacing = 4.0 / 3.0;
  const double lowest = laser % 2 == 0 ? -92.0 / 3.0 : -28.0 / 3.0;
  return (lowest + spacing * (laser / 2)) * degree;
}

Duration SpinningLidar::firing_offset(Index firing) const {
  return Duration(period().count() * firing / options_.firings_per_revolution);
}

Revolution SpinningLidar::turn(const RayCaster& world, const Drive& drive, Index index) const {
  Revolution revolution{.start = index * period(), .returns = {}};
  const Rng rng = noise_.fork(static_cast<std::uint64_t>(index));
  for (Index firing = 0; firing < options_.firings_per_revolution; ++firing) {
    // The vehicle moves by a third of a millimetre while one firing's lasers go off: one pose, at their middle, does.
    const Duration time = revolution.start + firing_offset(firing) + laser_offset(lasers) / 2;
    const SE3d T_map_lidar = drive.pose(to_seconds(time)) * true_T_body_lidar_;
    fire(world, T_map_lidar, firing, rng.fork(static_cast<std::uint64_t>(firing)), revolution.returns);
  }
  return revolution;
}

void SpinningLidar::fire(const RayCaster& world, const SE3d& T_map_lidar, Index firing, Rng rng,
                         std::vector<LidarReturn>& returns) const {
  const double azimuth = std::numbers::pi * (1.0 - (2.0 * firing + 1.0) / options_.firings_per_revolution);
  const double cosine = std::cos(azimuth);
  const double sine = std::sin(azimuth);
  const Eigen::Matrix3d R_map_lidar = T_map_lidar.rotation().matrix();
  const Eigen::Vector3f origin = T_map_lidar.translation().cast<float>();
  for (Index i = 0; i < lasers; ++i) {
    const Laser& laser = lasers_[static_cast<std::size_t>(i)];
    const Eigen::Vector3f direction = (R_map_lidar * turned(cosine, sine, laser.actual)).cast<float>();
    const auto hit = world.cast({.origin = origin,
                                 .direction = direction.normalized(),
                                 .max_distance = static_cast<float>(options_.max_range)});
    if (!hit) continue;
    const double incidence = std::max(1e-3, static_cast<double>(std::abs(hit->normal.dot(direction))));
    const auto range = measure(options_, *hit, incidence, laser.range_bias, rng);
    if (!range) continue;
    const double albedo = reflectivity[static_cast<std::size_t>(hit->material)];
    returns.push_back({.position = (*range * turned(cosine, sine, laser.nominal)).cast<float>(),
                       .firing = static_cast<std::uint16_t>(firing),
                       .laser = static_cast<std::uint8_t>(i),
                       .intensity = static_cast<std::uint8_t>(255.0 * albedo * std::sqrt(incidence))});
  }
}

LidarScan SpinningLidar::to_scan(const Revolution& revolution, Timestamp epoch) const {
  LidarScan scan;
  scan.time = epoch + revolution.start;
  scan.end = scan.time + firing_offset(options_.firings_per_revolution - 1) + laser_offset(lasers);
  for (const LidarReturn& hit : revolution.returns) {
    scan.cloud.positions.push_back(hit.position);
    scan.cloud.intensities.push_back(static_cast<float>(hit.intensity));
    scan.cloud.time_offsets.push_back(
        static_cast<float>(to_seconds(firing_offset(hit.firing) + laser_offset(hit.laser))));
  }
  return scan;
}

}  // namespace chainslam::simulator
