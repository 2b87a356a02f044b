#pragma once

#include <Eigen/Core>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// How far odometry between two keyframes may be off: by the way and the turn between them, and by what odometry itself
/// says of the two frames.
///
/// Set on real drives with truth, so that chains of steps of 3 m are off by as much as expected over 1, 10 and 100 m,
/// and held on simulated ones: bench/results.md, "Odometry noise". One set serves `LidarOdometry`,
/// `LidarInertialOdometry` and FAST-LIO2, since it is the map, not the filter, that makes most of their errors.
struct OdometryNoise {
  double translation = 0.01;             ///< metres per step,
  double translation_per_metre = 0.007;  ///< and per metre between its ends
  double rotation = 0.0006;              ///< radians per step,
  double rotation_per_metre = 0.0001;    ///< per metre between its ends,
  double rotation_per_radian = 0.012;    ///< and per radian turned: clocks, and sweeps while the rate changes
  /// Share of the deviations that odometry states of its frames which counts for the relative pose. Less than all,
  /// since part of an error is that of both frames: where the local map began, and of filters how the LiDAR is mounted.
  double stated_translation = 0.5;
  double stated_rotation = 0.2;  ///< the same for the rotation

  /// Of T_from_to, tangent [translation; rotation].
  [[nodiscard]] NoiseModel<6> operator()(const SE3d& T_from_to) const {
    return NoiseModel<6>::from_sigmas(sigmas(T_from_to));
  }

  /// The same with covariance beside it.
  /// @param added  positive semi-definite but for rounding.
  [[nodiscard]] NoiseModel<6> operator()(const SE3d& T_from_to, const Matrix6d& added) const {
    constexpr double rounding = 1e-9;
    const Vector6d by_way = sigmas(T_from_to);
    Matrix6d covariance;
    for (int j = 0; j < 6; ++j)
      for (int i = 0; i < 6; ++i)
        covariance(i, j) =
            0.5 * (added(i, j) + added(j, i)) + (i == j ? by_way[i] * by_way[i] + rounding * added(i, i) : 0.0);
    return NoiseModel<6>::from_covariance(covariance);
  }

  /// What counts of the covariance that two frames' own make of their relative pose: see `stated_covariance`.
  [[nodiscard]] Matrix6d share_of(Matrix6d stated) const {
    for (int j = 0; j < 6; ++j)
      for (int i = 0; i < 6; ++i)
        stated(i, j) *= (i < 3 ? stated_translation : stated_rotation) * (j < 3 ? stated_translation : stated_rotation);
    return stated;
  }

 private:
  [[nodiscard]] Vector6d sigmas(const SE3d& T_from_to) const {
    const double way = T_from_to.translation().norm(), turn = T_from_to.rotation().log().norm();
    Vector6d sigmas;
    for (int i = 0; i < 6; ++i)
      sigmas[i] = i < 3 ? translation + translation_per_metre * way
                        : rotation + rotation_per_metre * way + rotation_per_radian * turn;
    return sigmas;
  }
};

/// The same of odometry that says nothing of its errors, such as another system's recorded one: loose enough for poses
/// that shake, which only a looser rotation takes up. Set on three real drives of NCLT, whose rotations are off by 0.01
/// rad from one keyframe to the next and by not much more after 100 m; held on FAST-LIO2's recorded poses of MulRan
/// KAIST 02.
[[nodiscard]] inline OdometryNoise unknown_odometry_noise() {
  return {.translation = 0.08,
          .translation_per_metre = 0.02,
          .rotation = 0.004,
          .rotation_per_metre = 0.0008,
          .rotation_per_radian = 0.0};
}

}  // namespace chainslam
