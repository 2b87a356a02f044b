#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <memory>
#include <utility>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/odometry/detail/inertial_motion.hpp"
#include "chainslam/odometry/imu_process.hpp"
#include "chainslam/odometry/scan_to_map.hpp"
#include "chainslam/sensor/frame.hpp"

namespace chainslam::detail {

/// A sweep, straightened.
struct SweepClouds {
  PointCloud<float> whole;        ///< body frame at the sweep's end
  PointCloud<float> map, points;  ///< of these, for the map and for the filter; positions alone
};

/// Where a sweep is looked for.
struct SweepGuess {
  InertialState state{};              ///< where iterations start
  double error = 0;                   ///< metres that the prediction may put a point from its place
  Vector6d bend = zeros<Vector6d>();  ///< by how much the predicted way is bent at its end, tangent of the pose there
};

/// A sweep, straightened and measured from one guess.
struct SweepAttempt {
  SweepClouds clouds;
  InertialMotion::Filter filter;
  FilterReport<InertialState> report;
  ScanMatch match;
  double pose_nis = 0;
  SE3d own_pose;          ///< of the sweep, body frame, by its matches alone
  double time_error = 0;  ///< seconds that the sweep was taken later than stated
  /// By how much it lies elsewhere than its prediction, which is nevertheless kept: metres, odom; zero if it does not.
  Eigen::Vector3d odd = zeros<Eigen::Vector3d>();

  [[nodiscard]] bool is_odd() const { return odd.norm() > 0; }
  [[nodiscard]] double match_ratio() const {
    return static_cast<double>(match.matches) / std::max<double>(1, to_index(clouds.points.size()));
  }
};
/// Attempts are large, and compared one with the other.
using SweepAttemptPtr = std::unique_ptr<SweepAttempt>;

/// Which of several attempts a scan is taken by.
struct SweepChoice {
  SweepAttemptPtr best{};
  ImuUse use = ImuUse::all;  ///< that it believed
  double enough = 0;         ///< matches that a better one must exceed

  /// Takes the offer if it agrees with its prediction and matches clearly more than those before.
  void offer(SweepAttemptPtr attempt, ImuUse believed, bool fits, bool agrees) {
    constexpr double clearly = 1.05, clearly_than_lost = 1.25;  // more matches; the latter than what did not fit
    const auto matches = static_cast<double>(attempt->match.matches);
    const bool better = agrees && matches > enough;
    if (agrees || !fits) enough = std::max(enough, matches * (fits ? clearly : clearly_than_lost));
    if (!better) return;
    best = std::move(attempt);
    use = believed;
  }
};

}  // namespace chainslam::detail
