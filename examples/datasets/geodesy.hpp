#pragma once

#include "chainslam/sensor/gnss_fix.hpp"

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

}  // namespace chainslam::datasets
