#pragma once

#include <Eigen/Core>

#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// How far odometry between two keyframes may be off, by the way between them.
///
/// The defaults are for `LidarOdometry`: over 1, 10 and 100 m of four simulated drives through a town, taken as chains
/// of steps of 3 m, its squared errors are on average 0.3, 0.6 and 1.2 times as large as expected.
struct OdometryNoise {
  double translation = 0.02;             ///< metres per step,
  double translation_per_metre = 0.005;  ///< and per metre travelled
  double rotation = 0.001;               ///< radians per step,
  double rotation_per_metre = 0.0002;    ///< and per metre travelled

  [[nodiscard]] OdometryNoise scaled(double factor) const {
    return {factor * translation, factor * translation_per_metre, factor * rotation, factor * rotation_per_metre};
  }

  /// Of T_from_to, tangent [translation; rotation].
  [[nodiscard]] NoiseModel<6> operator()(const SE3d& T_from_to) const {
    return NoiseModel<6>::from_sigmas(sigmas(T_from_to));
  }

  /// The same where frames between were lost or degenerate.
  /// @param doubt  covariance that they add, of `OdometryDoubt`; positive semi-definite but for rounding.
  [[nodiscard]] NoiseModel<6> operator()(const SE3d& T_from_to, const Matrix6d& doubt) const {
    constexpr double rounding = 1e-9;
    const Vector6d of_odometry = sigmas(T_from_to);
    Matrix6d covariance;
    for (int j = 0; j < 6; ++j)
      for (int i = 0; i < 6; ++i)
        covariance(i, j) = 0.5 * (doubt(i, j) + doubt(j, i)) +
                           (i == j ? of_odometry[i] * of_odometry[i] + rounding * doubt(i, i) : 0.0);
    return NoiseModel<6>::from_covariance(covariance);
  }

 private:
  [[nodiscard]] Vector6d sigmas(const SE3d& T_from_to) const {
    const double way = T_from_to.translation().norm();
    Vector6d sigmas;
    for (int i = 0; i < 6; ++i)
      sigmas[i] = i < 3 ? translation + translation_per_metre * way : rotation + rotation_per_metre * way;
    return sigmas;
  }
};

/// The same of `LidarInertialOdometry`, fitted to simulated drives, four through a town and one over a campus: 0.6, 1.0
/// and 1.0 times as large on average, of a single drive 0.3 to 2.1 times.
[[nodiscard]] inline OdometryNoise inertial_odometry_noise() {
  return {.translation = 0.01, .translation_per_metre = 0.002, .rotation = 0.0003, .rotation_per_metre = 0.0001};
}

}  // namespace chainslam
