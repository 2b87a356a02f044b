#pragma once

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam::detail {

/// Covariance of the first pose, which is the origin by definition: m^2 and rad^2.
[[nodiscard]] inline Matrix6d anchored_covariance() {
  Matrix6d covariance = zeros<Matrix6d>();
  for (int i = 0; i < 6; ++i) covariance(i, i) = 1e-12;
  return covariance;
}

/// What registration to the local map does not know of a pose's error: the time without a match, and where a local map
/// lies that was restarted at a pose that nothing had confirmed.
///
/// Without a match the motion counts as unknown, whatever was predicted: that the scan does not fit is evidence against
/// the prediction. Deviations grow linearly with the time, by `speed` and `rate`: where filters lost KITTI 00 (92
/// scans, up to 7 s) they went astray by 2 to 8.7 m/s, all axes together. Good predictions over scans made unusable
/// there were within 0.1 to 0.5 m/s.
class PoseDoubt {
 public:
  static constexpr double speed = 5;   ///< m/s, each axis
  static constexpr double rate = 0.1;  ///< rad/s, the same

  void match() { since_match_ = 0; }
  void lose(double seconds) { since_match_ += seconds; }

  /// The local map begins anew at a pose of this covariance.
  void restart(const SE3d& T_odom_body, const Matrix6d& covariance) {
    T_odom_restart_ = T_odom_body;
    restart_covariance_ = covariance;
    restarted_ = true;
    since_match_ = 0;
  }

  /// Covariance of a pose in `odom`, tangent [translation; rotation].
  /// @param in_map  the same in the local map, by registration or prediction.
  [[nodiscard]] Matrix6d in_odom(const SE3d& T_odom_body, const Matrix6d& in_map) const {
    Matrix6d covariance = in_map;
    for (int i = 0; i < 6; ++i) {
      const double deviation = since_match_ * (i < 3 ? speed : rate);
      covariance(i, i) += deviation * deviation;
    }
    if (!restarted_) return covariance;
    // An error of the restart turns and moves all that follows.
    const Matrix6d to_body = (T_odom_body.inverse() * T_odom_restart_).adjoint();
    const Matrix6d carried = product_transposed(product(to_body, restart_covariance_), to_body);
    for (int j = 0; j < 6; ++j)
      for (int i = 0; i < 6; ++i) covariance(i, j) += 0.5 * (carried(i, j) + carried(j, i));
    return covariance;
  }

 private:
  double since_match_ = 0;  ///< seconds
  bool restarted_ = false;
  SE3d T_odom_restart_;
  Matrix6d restart_covariance_ = zeros<Matrix6d>();
};

}  // namespace chainslam::detail
