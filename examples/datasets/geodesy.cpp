#include "datasets/geodesy.hpp"

#include <GeographicLib/Geocentric.hpp>
#include <GeographicLib/LocalCartesian.hpp>
#include <GeographicLib/UTMUPS.hpp>
#include <cmath>
#include <string>
#include <vector>

namespace chainslam::datasets {

bool plausible(const GeodeticPosition& position) {
  return std::abs(position.latitude_deg) <= 90 && std::abs(position.longitude_deg) <= 360 &&
         std::abs(position.altitude) < 1e5;
}

GnssFix make_fix(Timestamp time, const GeodeticPosition& position, const GnssDeviation& deviation,
                 GnssQuality quality) {
  GnssFix fix{.time = time, .quality = quality};
  std::vector<double> rotation(9);
  GeographicLib::Geocentric::WGS84().Forward(position.latitude_deg, position.longitude_deg, position.altitude,
                                             fix.position_ecef.x(), fix.position_ecef.y(), fix.position_ecef.z(),
                                             rotation);
  const Eigen::Matrix3d R_ecef_enu = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(rotation.data());
  const Eigen::Vector3d variance(deviation.horizontal * deviation.horizontal,
                                 deviation.horizontal * deviation.horizontal, deviation.vertical * deviation.vertical);
  fix.covariance_ecef = R_ecef_enu * variance.asDiagonal() * R_ecef_enu.transpose();
  return fix;
}

Eigen::Vector3d east_north_up(const GeodeticPosition& origin, const GeodeticPosition& position) {
  const GeographicLib::LocalCartesian local(origin.latitude_deg, origin.longitude_deg, origin.altitude);
  Eigen::Vector3d enu;
  local.Forward(position.latitude_deg, position.longitude_deg, position.altitude, enu.x(), enu.y(), enu.z());
  return enu;
}

UtmZone utm_zone(const Eigen::Vector3d& ecef) {
  double latitude = 0, longitude = 0, height = 0;
  GeographicLib::Geocentric::WGS84().Reverse(ecef.x(), ecef.y(), ecef.z(), latitude, longitude, height);
  return {GeographicLib::UTMUPS::StandardZone(latitude, longitude, GeographicLib::UTMUPS::UTM), latitude >= 0};
}

Eigen::Vector3d utm(const UtmZone& zone, const Eigen::Vector3d& ecef) {
  double latitude = 0, longitude = 0, height = 0, easting = 0, northing = 0;
  GeographicLib::Geocentric::WGS84().Reverse(ecef.x(), ecef.y(), ecef.z(), latitude, longitude, height);
  int found = 0;
  bool north = true;
  GeographicLib::UTMUPS::Forward(latitude, longitude, found, north, easting, northing, zone.number);
  // Across the equator, northings go on from the zone's own half.
  if (north != zone.north) northing += zone.north ? -1e7 : 1e7;
  return {easting, northing, height};
}

int epsg_of(const UtmZone& zone) { return (zone.north ? 32600 : 32700) + zone.number; }

std::string wkt_of(const UtmZone& zone) {
  return "PROJCS[\"WGS 84 / UTM zone " + std::to_string(zone.number) + (zone.north ? "N" : "S") +
         R"(",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],)"
         R"(AUTHORITY["EPSG","6326"]],PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],)"
         R"(UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],AUTHORITY["EPSG","4326"]],)"
         R"(PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",)" +
         std::to_string(6 * zone.number - 183) +
         R"(],PARAMETER["scale_factor",0.9996],PARAMETER["false_easting",500000],PARAMETER["false_northing",)" +
         (zone.north ? "0" : "10000000") +
         R"(],UNIT["metre",1,AUTHORITY["EPSG","9001"]],AXIS["Easting",EAST],AXIS["Northing",NORTH],)"
         R"(AUTHORITY["EPSG",")" +
         std::to_string(epsg_of(zone)) + "\"]]";
}

}  // namespace chainslam::datasets
