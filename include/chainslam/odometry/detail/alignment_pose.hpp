#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/odometry/imu_process.hpp"

namespace chainslam {

namespace detail {

/// A pose of the LiDAR with what follows from it and its neighbours.
struct AlignmentPose {
  double time = 0;  ///< s
  SO3d R;           ///< R_odom_lidar
  Eigen::Vector3d p = Eigen::Vector3d::Zero();
  double rotation_variance = 0, position_variance = 0;
  int turned = 0;                                  ///< over how many poses the rotation is compared; 0: not
  Eigen::Vector3d turn = Eigen::Vector3d::Zero();  ///< rotation vector over these
  double turn_variance = 0;
  int left = 0, right = 0;                          ///< how many poses away those of the second difference are
  Eigen::Vector3d accel = Eigen::Vector3d::Zero();  ///< second difference of the position, LiDAR axes, m/s^2
  Eigen::Matrix3d lever = Eigen::Matrix3d::Zero();  ///< the same of the attitude, 1/s^2
  double accel_variance = 0;
};

/// A mean acceleration from three positions at uneven times: weights of a second difference.
template <class Value>
[[nodiscard]] Value second_difference(const Value& left, const Value& middle, const Value& right, double before,
                                      double after) {
  const Value rise = (1 / after) * Value(right - middle), fall = (1 / before) * Value(middle - left);
  return (2 / (before + after)) * Value(rise - fall);
}

[[nodiscard]] inline AlignmentPose alignment_pose(const LidarPose& pose, double time) {
  AlignmentPose result;
  result.time = time;
  result.R = pose.T_odom_lidar.rotation();
  result.p = pose.T_odom_lidar.translation();
  result.rotation_variance = pose.rotation_deviation * pose.rotation_deviation;
  result.position_variance = pose.position_deviation * pose.position_deviation;
  return result;
}

/// Fills in the acceleration of `middle`, between poses `before` and `after` seconds away.
inline void set_acceleration(AlignmentPose& middle, const AlignmentPose& left, const AlignmentPose& right) {
  const double before = middle.time - left.time, after = right.time - middle.time;
  const Eigen::Matrix3d to_middle = middle.R.inverse().matrix();
  middle.accel = product(to_middle, second_difference(left.p, middle.p, right.p, before, after));
  middle.lever =
      product(to_middle, second_difference(left.R.matrix(), middle.R.matrix(), right.R.matrix(), before, after));
  const double by_left = 2 / ((before + after) * before), by_right = 2 / ((before + after) * after);
  middle.accel_variance = by_left * by_left * left.position_variance + by_right * by_right * right.position_variance +
                          (by_left + by_right) * (by_left + by_right) * middle.position_variance;
}

/// What the newest of `poses` adds: its rotation since one before, and accelerations of those `half_span` (s) earlier.
/// Poses more than `max_step` (s) apart are not compared.
///
/// Rotations are compared with the pose before. Where times are off by much, the error of each is in two of these,
/// which hides an offset that all have: then over `max_step`, and where the body turns with less weight.
/// @param time_deviation  seconds, of the newest pose.
inline void link_to_neighbours(std::vector<AlignmentPose>& poses, double half_span, double max_step,
                               double time_deviation) {
  constexpr double exact = 0.005;  // seconds: less hides nothing that matters
  if (poses.size() < 2) return;
  AlignmentPose& now = poses.back();
  const std::size_t last = poses.size() - 1;
  const auto span_to = [&](std::size_t k) { return now.time - poses[k].time; };
  if (span_to(last - 1) <= max_step) {
    std::size_t from = last - 1;
    while (time_deviation > exact && from > 0 && span_to(from - 1) <= max_step) --from;
    now.turned = static_cast<int>(last - from);
    now.turn = poses[from].R.local(now.R);
    const double by_times = now.turn.norm() * time_deviation / span_to(from);
    now.turn_variance = now.rotation_variance + poses[from].rotation_variance + 2 * by_times * by_times;
  }
  if (!std::isfinite(now.position_variance)) return;
  for (std::size_t j = last; j-- > 0 && poses[j].right == 0 && now.time - poses[j].time <= max_step;) {
    AlignmentPose& middle = poses[j];
    if (now.time - middle.time < half_span) continue;
    std::size_t i = j;
    while (i > 0 && middle.time - poses[i].time < half_span) --i;
    const double span = middle.time - poses[i].time;
    if (span < half_span || span > max_step) continue;
    middle.left = static_cast<int>(j - i);
    middle.right = static_cast<int>(last - j);
    set_acceleration(middle, poses[i], now);
  }
}

}  // namespace detail
}  // namespace chainslam
