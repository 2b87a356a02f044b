#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cstddef>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "chainslam/core/finite.hpp"
#include "chainslam/core/jacobi_eigen.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/factor_graph/prior_factor.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/lie/umeyama.hpp"
#include "chainslam/sensor/gnss_fix.hpp"

namespace chainslam {

/// How GNSS fixes hold the map.
struct GnssFactorOptions {
  bool enabled = true;
  Eigen::Vector3d antenna = Eigen::Vector3d::Zero();  ///< in the body, metres: the lever arm
  /// Metres that a fix may be off beyond what it says: the receiver's bias, which is another on each day.
  double bias = 2.0;
  /// Fixes one after another that err together: so many count as one.
  double correlated = 10.0;
  double threshold = 30.0;   ///< squared whitened residual beyond which a fix is an outlier
  double max_sigma = 20.0;   ///< metres: fixes that state more are not used
  Index least_fixes = 20;    ///< before a frame is put on the Earth,
  double least_spread = 15;  ///< and metres (rms) that they must spread across their main direction
};

/// A position in a frame, and where the fix that was taken there lies on the Earth.
struct FixedPosition {
  Eigen::Vector3d position;  ///< of the antenna, metres
  Eigen::Vector3d ecef;
};

/// Where a frame of the map lies on the Earth: T_frame_ecef that brings fixes onto their positions, several times: each
/// time without those that the last was off by more than twice the median.
/// @returns nothing if they are too few, or too much on one line to say.
[[nodiscard]] [[gnu::cold]] inline std::optional<SE3d> georeference(std::span<const FixedPosition> fixes,
                                                                    const GnssFactorOptions& options) {
  std::optional<SE3d> found;
  double most = std::numeric_limits<double>::infinity();
  for (int pass = 0; pass < 6; ++pass) {
    std::vector<Eigen::Vector3d> ecef, positions;
    for (const FixedPosition& fix : fixes) {
      if (found && (*found * fix.ecef - fix.position).norm() > most) continue;
      ecef.push_back(fix.ecef);
      positions.push_back(fix.position);
    }
    if (to_index(ecef.size()) < options.least_fixes) return found;
    const Eigen::Vector3d middle = detail::mean(positions);
    Eigen::Matrix3d spread = zeros<Eigen::Matrix3d>();
    for (const Eigen::Vector3d& position : positions)
      spread += (position - middle) * (position - middle).transpose() / static_cast<double>(positions.size());
    if (!(jacobi_eigen(spread).values[1] >= options.least_spread * options.least_spread)) return found;
    const auto fitted = umeyama(ecef, positions, false);
    if (!fitted) return found;
    found = SE3d(fitted->rotation(), fitted->translation());
    std::vector<double> distances;
    for (const FixedPosition& fix : fixes) distances.push_back((*found * fix.ecef - fix.position).norm());
    std::nth_element(distances.begin(), distances.begin() + static_cast<std::ptrdiff_t>(distances.size() / 2),
                     distances.end());
    most = std::max(2 * distances[distances.size() / 2], 2 * options.bias);
  }
  return found;
}

/// What a fix says of the pose of the keyframe that it was taken at: a prior whose rotation is open.
/// @param antenna   where it puts the antenna, in the map's frame, metres
/// @param attitude  of the body, by the estimate
[[nodiscard]] [[gnu::cold]] inline PriorFactor<SE3d> position_prior(Key key, const Eigen::Vector3d& antenna,
                                                                    const GnssFix& fix, const SO3d& R_map_ecef,
                                                                    const SO3d& attitude,
                                                                    const GnssFactorOptions& options) {
  const Eigen::Matrix3d R_body_ecef = (attitude.inverse() * R_map_ecef).matrix();
  Eigen::Matrix3d covariance = R_body_ecef * fix.covariance_ecef * R_body_ecef.transpose();
  for (int i = 0; i < 3; ++i) covariance(i, i) += options.bias * options.bias;
  covariance *= options.correlated;
  PriorFactor<SE3d> prior{key, SE3d(attitude, antenna - attitude * options.antenna), zeros<SqrtInformation<6>>()};
  prior.sqrt_information.topLeftCorner<3, 3>() = NoiseModel<3>::from_covariance(covariance).sqrt_information();
  return prior;
}

/// Whether a fix says enough to hold anything.
[[nodiscard]] [[gnu::cold]] inline bool is_usable(const GnssFix& fix, const GnssFactorOptions& options) {
  if (fix.quality == GnssQuality::none || !is_finite(fix.position_ecef)) return false;
  for (int i = 0; i < 3; ++i)
    if (!(fix.covariance_ecef(i, i) <= options.max_sigma * options.max_sigma)) return false;
  return true;
}

}  // namespace chainslam
