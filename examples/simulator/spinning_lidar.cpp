#include "simulator/spinning_lidar.hpp"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

#include "simulator/angle.hpp"
#include "simulator/day.hpp"
#include "simulator/range_measurement.hpp"

namespace chainslam::simulator {

namespace {

Eigen::Vector3d random_direction(Rng& rng) {
  Eigen::Vector3d direction;
  for (int axis = 0; axis < 3; ++axis) direction[axis] = rng.normal();
  return direction.normalized();
}

Eigen::Vector3d unit_vector(double azimuth, double elevation) {
  return {std::cos(elevation) * std::cos(azimuth), std::cos(elevation) * std::sin(azimuth), std::sin(elevation)};
}

Eigen::Vector3d turned(double cosine, double sine, const Eigen::Vector3d& v) {
  return {cosine * v.x() - sine * v.y(), sine * v.x() + cosine * v.y(), v.z()};
}

/// Those whom a firing's rays may meet, where they are then.
std::vector<Halted> ahead_of(const Eigen::Vector3f& origin, const Eigen::Vector3f& ahead, float half_spread,
                             std::span<const Passing> passing, float part) {
  std::vector<Halted> found;
  const Eigen::Vector2f direction = ahead.head<2>().normalized();
  for (const Passing& one : passing) {
    const Eigen::Vector2f offset = (one.at(part) - origin).head<2>();
    const float off = std::abs(direction.x() * offset.y() - direction.y() * offset.x());
    if (offset.dot(direction) > -one.radius && off < half_spread * offset.norm() + one.radius)
      found.emplace_back(one, part);
  }
  return found;
}

}  // namespace

SpinningLidar::SpinningLidar(const LidarOptions& options, Rng unit, Index day)
    : options_(options), model_(&lidar_model(options.kind)), noise_(on_day(unit, day)) {
  if (options.firings_per_revolution <= 0 || options.firings_per_revolution % model_->firings_per_packet != 0)
    throw std::invalid_argument("SpinningLidar: firings_per_revolution must be a positive multiple of " +
                                std::to_string(model_->firings_per_packet));
  const auto& channels = model_->channels;
  firing_duration_ = channels.back().delay + (channels[1].delay - channels[0].delay);
  double widest = 8.0;  // degrees: a tilt of 10 degrees moves rays at 30 degrees of elevation by 5
  for (const LidarChannel& one : channels) widest = std::max(widest, 8.0 + std::abs(one.azimuth_deg));
  half_spread_ = static_cast<float>(std::sin(widest * degree));
  const Eigen::Vector3d axis = random_direction(unit);
  const Eigen::Vector3d shift = random_direction(unit);
  const SE3d& nominal = options.T_body_lidar;
  true_T_body_lidar_ = SE3d(nominal.rotation() * SO3d::exp(options.mount_angle_deg * degree * axis),
                            nominal.translation() + options.mount_shift * shift);

  Rng warming = unit.fork(0);
  const double turn_rate = -2.0 * std::numbers::pi / options.period;
  for (Index laser = 0; laser < lasers(); ++laser) {
    const auto either_way = [](Rng& rng, double least, double most) {
      const double sign = rng.uniform() < 0.5 ? -1.0 : 1.0;
      return sign * rng.uniform(least, most);
    };
    const double error = either_way(unit, 0.2, 1.0) * options.elevation_error_deg * degree;
    const double bias = either_way(unit, 0.5, 1.5) * options.range_bias;
    const double azimuth = turn_rate * to_seconds(laser_offset(laser)) + channel(laser).azimuth_deg * degree;
    const double elevation = nominal_elevation(laser);
    const double actual = elevation + options.elevation_offset_deg * degree + error;
    lasers_.push_back({.nominal = unit_vector(azimuth, elevation),
                       .actual = unit_vector(azimuth, actual),
                       .range_bias = bias,
                       .azimuth = azimuth,
                       .elevation = actual,
                       .elevation_drift = either_way(warming, 0.2, 1.0) * options.elevation_drift_deg * degree,
                       .range_drift = either_way(warming, 0.5, 1.5) * options.range_drift});
  }
}

std::vector<SpinningLidar::Laser> SpinningLidar::lasers_at(double time) const {
  std::vector<Laser> lasers = lasers_;
  if (options_.elevation_drift_deg == 0.0 && options_.range_drift == 0.0) return lasers;
  const double warm = 1.0 - std::exp(-time / options_.warm_up_time);
  for (Laser& laser : lasers) {
    laser.actual = unit_vector(laser.azimuth, laser.elevation + warm * laser.elevation_drift);
    laser.range_bias += warm * laser.range_drift;
  }
  return lasers;
}

double SpinningLidar::nominal_elevation(Index laser) const { return channel(laser).elevation_deg * degree; }

Duration SpinningLidar::firing_offset(Index firing) const {
  return Duration(period().count() * firing / options_.firings_per_revolution);
}

bool SpinningLidar::arrives(Index index) const {
  // Streams of their own: whatever else is drawn stays the same.
  return noise_.fork(static_cast<std::uint64_t>(index)).fork(~std::uint64_t{0}).uniform() >= options_.lost_scans;
}

Revolution SpinningLidar::turn(const RayCaster& world, const VehicleMotion& drive, Index index,
                               std::span<const Passing> passing) const {
  Revolution revolution{.start = index * period(), .returns = {}};
  if (!arrives(index)) return revolution;
  const Rng rng = noise_.fork(static_cast<std::uint64_t>(index));
  const double start = to_seconds(revolution.start);
  const double clock_error = options_.clock_offset + options_.clock_drift * start +
                             options_.clock_jitter * rng.fork(~std::uint64_t{1}).normal();
  const Rng packets = rng.fork(~std::uint64_t{2});
  Surroundings around{world, passing, lasers_at(start), std::vector<float>(model_->channels.size(), infinite_distance)};
  for (Index firing = 0; firing < options_.firings_per_revolution; ++firing) {
    const auto packet = static_cast<std::uint64_t>(firing / model_->firings_per_packet);
    if (options_.lost_packets > 0.0 && packets.fork(packet).uniform() < options_.lost_packets) continue;
    // The vehicle moves by half a millimetre while one firing's lasers go off: one pose, at their middle, does.
    const double time = to_seconds(revolution.start + firing_offset(firing) + firing_duration_ / 2) + clock_error;
    const SE3d T_map_lidar = drive.pose(time) * true_T_body_lidar_;
    fire(around, {T_map_lidar, time, firing, rng.fork(static_cast<std::uint64_t>(firing))}, revolution.returns);
  }
  return revolution;
}

void SpinningLidar::fire(Surroundings& around, Shot shot, std::vector<LidarReturn>& returns) const {
  const double part = (2.0 * shot.firing + 1.0) / options_.firings_per_revolution;  // of two turns
  const double azimuth = std::numbers::pi * (1.0 - part);
  const double cosine = std::cos(azimuth);
  const double sine = std::sin(azimuth);
  // With no eccentricity the reported azimuth is the true one, bit for bit.
  const double reported = azimuth + options_.encoder_eccentricity_deg * degree * cosine;
  const double reported_cosine = std::cos(reported);
  const double reported_sine = std::sin(reported);
  const double azimuth_before = azimuth + 2.0 * std::numbers::pi / options_.firings_per_revolution;
  const double cosine_before = std::cos(azimuth_before);
  const double sine_before = std::sin(azimuth_before);
  const Eigen::Matrix3d R_map_lidar = shot.T_map_lidar.rotation().matrix();
  const Eigen::Vector3f origin = shot.T_map_lidar.translation().cast<float>();
  const Eigen::Vector3f ahead = (R_map_lidar * Eigen::Vector3d(cosine, sine, 0.0)).cast<float>();
  const auto turned_part = static_cast<float>(0.5 * part);
  const auto in_the_way = ahead_of(origin, ahead, half_spread_, around.passing, turned_part);
  for (Index i = 0; i < lasers(); ++i) {
    const Laser& laser = around.lasers[static_cast<std::size_t>(i)];
    const Eigen::Vector3f direction = (R_map_lidar * turned(cosine, sine, laser.actual)).cast<float>();
    Ray ray{
        .origin = origin, .direction = direction.normalized(), .max_distance = static_cast<float>(options_.max_range)};
    auto hit = around.world.cast(ray);
    if (!in_the_way.empty()) {
      if (hit) ray.max_distance = hit->distance;
      if (const auto moving = meet(in_the_way, ray)) hit = moving;
      ray.max_distance = static_cast<float>(options_.max_range);
    }
    hit = through_weather(options_, around.world, {ray, shot.time}, hit, shot.rng);
    const float before =
        std::exchange(around.previous[static_cast<std::size_t>(i)], hit ? hit->distance : infinite_distance);
    if (!hit) continue;
    auto distance = static_cast<double>(hit->distance);
    if (options_.beam_width_deg > 0.0 && before < infinite_distance) {
      const Eigen::Vector3f earlier = (R_map_lidar * turned(cosine_before, sine_before, laser.actual)).cast<float>();
      const float expected = hit->distance * hit->normal.dot(direction) / hit->normal.dot(earlier);
      distance =
          spread_over_edge(options_, distance, static_cast<double>(before), static_cast<double>(expected), shot.rng);
    }
    const double incidence = std::max(1e-3, static_cast<double>(std::abs(hit->normal.dot(direction))));
    const auto range =
        measure(options_, {hit->material, distance, incidence, laser.range_bias, model_->range_of_tenth}, shot.rng);
    if (!range) continue;
    returns.push_back(
        {.position = (*range * turned(reported_cosine, reported_sine, laser.nominal)).cast<float>(),
         .firing = static_cast<std::uint16_t>(shot.firing),
         .laser = static_cast<std::uint8_t>(i),
         .intensity = static_cast<std::uint8_t>(255.0 * reflectivity(hit->material) * std::sqrt(incidence)),
         .presence = hit->presence});
  }
}

LidarScan SpinningLidar::to_scan(const Revolution& revolution, Timestamp epoch) const {
  LidarScan scan;
  scan.time = epoch + revolution.start;
  scan.end = scan.time + last_return();
  for (const LidarReturn& hit : revolution.returns) {
    scan.cloud.positions.push_back(hit.position);
    scan.cloud.intensities.push_back(static_cast<float>(hit.intensity));
    scan.cloud.time_offsets.push_back(
        static_cast<float>(to_seconds(firing_offset(hit.firing) + laser_offset(hit.laser))));
  }
  return scan;
}

}  // namespace chainslam::simulator
