#include "datasets/geodesy.hpp"

#include <GeographicLib/Geocentric.hpp>
#include <GeographicLib/LocalCartesian.hpp>
#include <cmath>
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

}  // namespace chainslam::datasets
