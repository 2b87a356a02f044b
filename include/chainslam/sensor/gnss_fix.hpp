#pragma once

#include <Eigen/Core>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"

namespace chainslam {

/// What the receiver says of its own fix.
enum class GnssQuality { none, two_dimensional, three_dimensional, differential, rtk_float, rtk_fixed };

/// One position of the GNSS antenna in WGS 84's Earth-centred frame, so that sessions with different origins compare.
struct GnssFix {
  Timestamp time{};                                               ///< of the measurement
  Eigen::Vector3d position_ecef = Eigen::Vector3d::Zero();        ///< metres
  Eigen::Matrix3d covariance_ecef = identity<Eigen::Matrix3d>();  ///< m^2
  GnssQuality quality = GnssQuality::none;                        ///< as the receiver states it
};

}  // namespace chainslam
