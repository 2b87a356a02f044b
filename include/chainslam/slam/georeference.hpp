#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <span>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/symmetric_eigen.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/factors.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/lie/umeyama.hpp"
#include "chainslam/sensor/packet.hpp"

namespace chainslam {

/// How GNSS fixes hold the map.
struct GnssFactorOptions {
  bool enabled = true;                                ///< whether fixes become factors
  Eigen::Vector3d antenna = Eigen::Vector3d::Zero();  ///< in the body, metres: the lever arm
  /// Metres that a fix may be off beyond what it says: the receiver's bias, which is another on each day.
  double bias = 2.0;
  /// Seconds that errors of fixes last, as the time constant of a Gauss-Markov process: fixes of twice this time count
  /// as one, however many they are. Those of receivers last for minutes; with fixes that weigh so little, drives whose
  /// odometry fails are not found out any more (three drives of NCLT).
  double correlation_time = 20.0;
  double threshold = 300.0;  ///< squared Mahalanobis distance of a fix by itself beyond which it is an outlier
  double max_sigma = 20.0;   ///< metres: fixes that state more are not used
  Index min_fixes = 20;      ///< before a frame is put on the Earth,
  double min_spread = 15;    ///< and metres (rms) that they must spread across their main direction
};

/// A position in a frame, and where the fix that was taken there lies on the Earth.
struct FixedPosition {
  Eigen::Vector3d position;  ///< of the antenna, metres
  Eigen::Vector3d ecef;      ///< metres, WGS 84's Earth-centred frame
};

/// Where a frame of the map lies on the Earth: T_frame_ecef that brings fixes onto their positions, several times: each
/// time without those that the last was off by more than twice the median.
/// @returns nothing if they are too few, or too much on one line to say.
[[nodiscard]] [[gnu::cold]] inline std::optional<SE3d> georeference(std::span<const FixedPosition> fixes,
                                                                    const GnssFactorOptions& options) {
  std::optional<SE3d> found;
  double most = std::numeric_limits<double>::infinity();
  const auto distance = [&](const FixedPosition& fix) {
    const Eigen::Vector3d there = *found * fix.ecef;
    return std::sqrt(squared_distance<3>(there.data(), fix.position.data()));
  };
  for (int pass = 0; pass < 6; ++pass) {
    std::vector<Eigen::Vector3d> ecef, positions;
    for (const FixedPosition& fix : fixes) {
      if (found && distance(fix) > most) continue;
      ecef.push_back(fix.ecef);
      positions.push_back(fix.position);
    }
    if (to_index(ecef.size()) < options.min_fixes) return found;
    const Eigen::Vector3d middle = detail::mean(positions);
    Eigen::Matrix3d spread = zeros<Eigen::Matrix3d>();
    for (const Eigen::Vector3d& position : positions) {
      const Eigen::Vector3d off = difference_of(position, middle);
      spread = sum_of(spread, divided(product_transposed(off, off), static_cast<double>(positions.size())));
    }
    if (!(jacobi_eigen(spread).values[1] >= options.min_spread * options.min_spread)) return found;
    const auto fitted = umeyama(ecef, positions, false);
    if (!fitted) return found;
    found = SE3d(fitted->rotation(), fitted->translation());
    detail::Table<Ranked> distances;
    for (const FixedPosition& fix : fixes) distances.push_back({distance(fix), 0});
    sort_ranked(distances.all());
    most = std::max(2 * distances[distances.size() / 2].rank, 2 * options.bias);
  }
  return found;
}

/// How many fixes err together with a fix and count as one, at least 1: the information that a Gauss-Markov process
/// leaves of its mean is that of one sample in twice its time constant. Errors of civilian receivers are such a process
/// ("Comparison of Enhanced Noise Model Performance Based on Analysis of Civilian GPS Data", Sensors 20, 2020, 6050).
/// @param since  seconds since the fix before it, more than 0
[[nodiscard]] inline double correlated_fixes(double since, const GnssFactorOptions& options) {
  return std::max(1.0, 2 * options.correlation_time / since);
}

/// What a fix says of the pose of the keyframe that it was taken at: a prior whose rotation is open.
/// @param antenna     where it puts the antenna, in the map's frame, metres
/// @param attitude    of the body, by the estimate
/// @param correlated  number of fixes that count as one
[[nodiscard]] [[gnu::cold]] inline PriorFactor<SE3d> position_prior(Key key, const Eigen::Vector3d& antenna,
                                                                    const GnssFix& fix, const SO3d& R_map_ecef,
                                                                    const SO3d& attitude, double correlated,
                                                                    const GnssFactorOptions& options) {
  const Eigen::Matrix3d R_body_ecef = (attitude.inverse() * R_map_ecef).matrix();
  Eigen::Matrix3d covariance = product_transposed(product(R_body_ecef, fix.covariance_ecef), R_body_ecef);
  for (int i = 0; i < 3; ++i) covariance(i, i) += options.bias * options.bias;
  covariance = scaled(correlated, covariance);
  PriorFactor<SE3d> prior{key, SE3d(attitude, antenna - attitude * options.antenna), zeros<SqrtInformation<6>>()};
  const SqrtInformation<3> root = NoiseModel<3>::from_covariance(covariance).sqrt_information();
  for (int j = 0; j < 3; ++j)
    for (int i = 0; i < 3; ++i) prior.sqrt_information(i, j) = root(i, j);
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
