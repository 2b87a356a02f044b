#include "simulator/gnss_receiver.hpp"

#include <GeographicLib/Geocentric.hpp>
#include <GeographicLib/LocalCartesian.hpp>
#include <cmath>
#include <limits>
#include <numbers>

#include "simulator/rig.hpp"

namespace chainslam::simulator {

namespace {

constexpr double degree = std::numbers::pi / 180.0;

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

/// Times without a fix.
class Outages {
 public:
  Outages(const GnssOptions& options, Rng rng) : options_(options), rng_(rng) { draw_next(0.0); }

  bool covers(double time) {
    while (time >= end_) draw_next(end_);
    return time >= start_;
  }

 private:
  void draw_next(double after) {
    start_ = after + options_.time_between_outages * rng_.uniform(0.5, 1.5);
    end_ = start_ + options_.outage_duration * rng_.uniform(0.5, 1.5);
  }

  GnssOptions options_;
  Rng rng_;
  double start_ = 0.0;
  double end_ = 0.0;
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

std::vector<GnssReading> record_gnss(const Drive& drive, const GnssOptions& options, Timestamp epoch, Rng rng) {
  PositionError error(options, rng.fork(0));
  Outages outages(options, rng.fork(1));
  Rng satellites = rng.fork(2);
  const Eigen::Matrix3d R = R_ecef_map();
  const Eigen::Matrix3d covariance = R * error.covariance() * R.transpose();
  std::vector<GnssReading> readings;
  Eigen::Vector3d last = map_to_geodetic(Eigen::Vector3d::Zero());
  const auto count = static_cast<Index>(drive.duration() * options.rate);
  for (Index i = 0; i <= count; ++i) {
    const Duration time = seconds(i / options.rate);
    const Motion motion = drive.motion(to_seconds(time));
    const Eigen::Vector3d measured = motion.T_map_body * nominal_antenna_body() + error.next();
    const Index in_view = 5 + satellites.uniform_index(6);
    GnssReading reading;
    reading.time = reading.fix.time = epoch + time;
    const bool lost = outages.covers(to_seconds(time));
    if (!lost) last = map_to_geodetic(measured);
    reading.mode = lost ? 0 : 3;
    reading.satellites = lost ? 2 : in_view;
    reading.latitude = last[0];
    reading.longitude = last[1];
    reading.altitude = lost ? std::numeric_limits<double>::quiet_NaN() : last[2];
    const double course = std::atan2(-motion.velocity_map.y(), motion.velocity_map.x());
    reading.track = course < 0.0 ? course + 2.0 * std::numbers::pi : course;
    reading.speed = motion.velocity_map.head<2>().norm();
    reading.fix.position_ecef = lost ? Eigen::Vector3d::Zero().eval() : map_to_ecef(measured);
    reading.fix.covariance_ecef = covariance;
    reading.fix.quality = lost ? GnssQuality::none : GnssQuality::three_dimensional;
    readings.push_back(reading);
  }
  return readings;
}

}  // namespace chainslam::simulator
