#include "simulator/gnss_receiver.hpp"

#include <GeographicLib/Geocentric.hpp>
#include <GeographicLib/LocalCartesian.hpp>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "simulator/angle.hpp"

namespace chainslam::simulator {

namespace {

const GeographicLib::LocalCartesian& origin() {
  static const GeographicLib::LocalCartesian frame(42.293227, -83.709657, 270.0);
  return frame;
}

/// Columns are the map's axes in the Earth's frame.
Eigen::Matrix3d R_ecef_map() {
  const Eigen::Vector3d zero = map_to_ecef(Eigen::Vector3d::Zero());
  Eigen::Matrix3d R;
  for (int axis = 0; axis < 3; ++axis) R.col(axis) = map_to_ecef(Eigen::Vector3d::Unit(axis)) - zero;
  return R;
}

/// Slow errors (constant and Gauss-Markov) and fast ones.
class PositionError {
 public:
  PositionError(const GnssOptions& options, Rng rng) : options_(options), rng_(rng) {
    const double bias = rng_.uniform(options.least_bias, options.most_bias);
    const double course = rng_.uniform(0.0, 2.0 * std::numbers::pi);
    bias_ << bias * std::cos(course), bias * std::sin(course), options.vertical * bias * rng_.uniform(-1.0, 1.0);
    wander_ = options.wander * draw();
  }

  Eigen::Vector3d next() {
    const double keep = std::exp(-1.0 / (options_.rate * options_.wander_time));
    wander_ = keep * wander_ + std::sqrt(1.0 - keep * keep) * options_.wander * draw();
    return bias_ + wander_ + options_.noise * draw();
  }

  /// What the receiver believes: right about the fast and wandering parts, unaware of the constant one.
  [[nodiscard]] Eigen::Matrix3d covariance() const {
    const double variance = options_.wander * options_.wander + options_.noise * options_.noise;
    return Eigen::Vector3d(1.0, 1.0, options_.vertical * options_.vertical).asDiagonal() * variance;
  }

 private:
  Eigen::Vector3d draw() {
    Eigen::Vector3d v;
    for (int axis = 0; axis < 3; ++axis) v[axis] = rng_.normal();
    v.z() *= options_.vertical;
    return v;
  }

  GnssOptions options_;
  Rng rng_;
  Eigen::Vector3d bias_;
  Eigen::Vector3d wander_;
};

/// Spans of time that come again and again, each 0.5 to 1.5 times as long, and as far from the one before, as the mean.
class Spells {
 public:
  /// @param between  mean time from the end of one to the start of the next, seconds; 0: none ever.
  Spells(double between, double duration, Rng rng) : between_(between), duration_(duration), rng_(rng) {
    draw_next(0.0);
  }

  bool covers(double time) {
    while (between_ > 0.0 && time >= end_) draw_next(end_);
    return between_ > 0.0 && time >= start_;
  }
  [[nodiscard]] double start() const { return start_; }  ///< of the one that covers the time asked for last

 private:
  void draw_next(double after) {
    start_ = after + between_ * rng_.uniform(0.5, 1.5);
    end_ = start_ + duration_ * rng_.uniform(0.5, 1.5);
  }

  double between_;
  double duration_;
  Rng rng_;
  double start_ = 0.0;
  double end_ = 0.0;
};

/// Signals that come by way of walls: a displacement that stays for the length of a burst.
class Multipath {
 public:
  Multipath(const GnssOptions& options, Rng rng)
      : size_(options.burst_size),
        vertical_(options.vertical),
        rng_(rng),
        in_the_open_(options.time_between_bursts, options.burst_duration, rng.fork(0)),
        between_walls_(0.3 * options.time_between_bursts, options.burst_duration, rng.fork(1)) {}

  Eigen::Vector3d displacement(double time, double sky) {
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    if (in_the_open_.covers(time)) sum += drawn_for(in_the_open_, 0.5);
    if (between_walls_.covers(time) && sky < 0.8) sum += drawn_for(between_walls_, 1.5 * (1.0 - sky));
    return sum;
  }

 private:
  [[nodiscard]] Eigen::Vector3d drawn_for(const Spells& burst, double part) const {
    Rng draw = rng_.fork(static_cast<std::uint64_t>(burst.start() * 1000.0) + 2);
    Eigen::Vector3d v;
    for (int axis = 0; axis < 3; ++axis) v[axis] = draw.normal(0.0, size_ * part);
    v.z() *= vertical_;
    return v;
  }

  double size_;
  double vertical_;
  Rng rng_;
  Spells in_the_open_;
  Spells between_walls_;
};

}  // namespace

Eigen::Vector3d map_to_geodetic(const Eigen::Vector3d& position_map) {
  double latitude = 0.0;
  double longitude = 0.0;
  double altitude = 0.0;
  origin().Reverse(-position_map.y(), position_map.x(), position_map.z(), latitude, longitude, altitude);
  return {latitude * degree, longitude * degree, altitude};
}

Eigen::Vector3d map_to_ecef(const Eigen::Vector3d& position_map) {
  const Eigen::Vector3d geodetic = map_to_geodetic(position_map);
  Eigen::Vector3d ecef;
  GeographicLib::Geocentric::WGS84().Forward(geodetic[0] / degree, geodetic[1] / degree, geodetic[2], ecef[0], ecef[1],
                                             ecef[2]);
  return ecef;
}

double open_sky(const RayCaster& world, const Eigen::Vector3d& position) {
  int open = 0;
  int all = 0;
  for (const double elevation : {20.0, 45.0, 75.0})
    for (int azimuth = 0; azimuth < 360; azimuth += 45, ++all) {
      const Eigen::Vector3d direction(std::cos(elevation * degree) * std::cos(azimuth * degree),
                                      std::cos(elevation * degree) * std::sin(azimuth * degree),
                                      std::sin(elevation * degree));
      const auto hit = world.cast({position.cast<float>(), direction.cast<float>().normalized(), 60.0F});
      open += !hit || hit->material == Material::foliage ? 1 : 0;
    }
  return static_cast<double>(open) / all;
}

std::vector<GnssReading> record_gnss(const VehicleMotion& drive, const RayCaster& world, const GnssOptions& options,
                                     Timestamp epoch, Rng rng) {
  constexpr double least_sky = 0.25;
  PositionError error(options, rng.fork(0));
  Spells outages(options.time_between_outages, options.outage_duration, rng.fork(1));
  Rng satellites = rng.fork(2);
  Multipath multipath(options, rng.fork(3));
  Rng flat = rng.fork(4);
  const Eigen::Matrix3d R = R_ecef_map();
  const Eigen::Matrix3d covariance = R * error.covariance() * R.transpose();
  std::vector<GnssReading> readings;
  Eigen::Vector3d last = map_to_geodetic(Eigen::Vector3d::Zero());
  const auto count = static_cast<Index>(drive.duration() * options.rate);
  for (Index i = 0; i <= count; ++i) {
    const Duration time = seconds(i / options.rate);
    const double at = to_seconds(time);
    const Motion motion = drive.motion(std::max(0.0, at - options.latency));
    const Eigen::Vector3d antenna = motion.T_map_body * options.antenna_body;
    const double sky = options.needs_sky ? open_sky(world, antenna) : 1.0;
    const Eigen::Vector3d measured = antenna + error.next() + multipath.displacement(at, sky);
    const Index in_view = 5 + satellites.uniform_index(6);
    GnssReading reading;
    reading.time = reading.fix.time = epoch + time;
    const bool lost = outages.covers(at) || sky < least_sky;
    const bool without_altitude = flat.uniform() < options.flat_fixes;
    if (!lost) last = map_to_geodetic(measured);
    reading.mode = lost ? 0 : without_altitude ? 2 : 3;
    reading.satellites = lost ? 2 : in_view;
    reading.latitude = last[0];
    reading.longitude = last[1];
    reading.altitude = lost || without_altitude ? std::numeric_limits<double>::quiet_NaN() : last[2];
    const double course = std::atan2(-motion.velocity_map.y(), motion.velocity_map.x());
    reading.track = course < 0.0 ? course + 2.0 * std::numbers::pi : course;
    reading.speed = motion.velocity_map.head<2>().norm();
    reading.fix.position_ecef = lost ? Eigen::Vector3d::Zero().eval() : map_to_ecef(measured);
    reading.fix.covariance_ecef = covariance;
    reading.fix.quality = lost               ? GnssQuality::none
                          : without_altitude ? GnssQuality::two_dimensional
                                             : GnssQuality::three_dimensional;
    readings.push_back(reading);
  }
  return readings;
}

}  // namespace chainslam::simulator
