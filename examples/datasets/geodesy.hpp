#pragma once

#include <Eigen/Core>
#include <string>

#include "chainslam/sensor/packet.hpp"

namespace chainslam::datasets {

/// A position on WGS 84, as receivers state it.
struct GeodeticPosition {
  double latitude_deg = 0;
  double longitude_deg = 0;
  double altitude = 0;  ///< metres above the ellipsoid
};

/// One standard deviation, metres.
struct GnssDeviation {
  double horizontal = 1;  ///< east and north, each
  double vertical = 2;
};

/// Whether latitude and longitude are on the globe and all is finite.
[[nodiscard]] bool plausible(const GeodeticPosition& position);

/// The fix in the Earth's frame, its covariance turned from east, north, up.
[[nodiscard]] GnssFix make_fix(Timestamp time, const GeodeticPosition& position, const GnssDeviation& deviation,
                               GnssQuality quality);

/// Where a position lies from another one, metres east, north and up of it.
[[nodiscard]] Eigen::Vector3d east_north_up(const GeodeticPosition& origin, const GeodeticPosition& position);

/// A zone of the universal transverse Mercator projection on WGS 84.
struct UtmZone {
  int number = 31;  ///< 1 to 60
  bool north = true;
};

/// The zone in which a place lies. @param ecef  metres, WGS 84's Earth-centred frame
[[nodiscard]] UtmZone utm_zone(const Eigen::Vector3d& ecef);

/// Easting, northing, and height above the ellipsoid, metres.
[[nodiscard]] Eigen::Vector3d utm(const UtmZone& zone, const Eigen::Vector3d& ecef);

/// EPSG's code of the projected coordinate system: 32601 to 32660, 32701 to 32760.
[[nodiscard]] int epsg_of(const UtmZone& zone);

/// The same system in well-known text (OGC 01-009), as EPSG has it.
[[nodiscard]] std::string wkt_of(const UtmZone& zone);

}  // namespace chainslam::datasets
