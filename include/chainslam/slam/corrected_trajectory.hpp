#pragma once

#include <algorithm>
#include <cstddef>
#include <span>
#include <stdexcept>

#include "chainslam/lie/se3.hpp"
#include "chainslam/map/keyframe.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam {

/// Carries the graph's corrections at the keyframes over to every pose of odometry between them.
///
/// Between keyframes a and b the correction to their relative pose, E = log((O_a^-1 O_b)^-1 X_a^-1 X_b), is spread
/// evenly over time: X(t) = X_a O_a^-1 O(t) exp(s E), s = (t - t_a) / (t_b - t_a). Before the first and after the last
/// keyframe, poses move rigidly with it. Keyframes keep their optimized poses exactly.
///
/// @param odometry   T_odom_body of every scan of one session, in time order.
/// @param keyframes  that session's keyframes in time order, with T_odom_body and T_map_body.
/// @returns T_map_body at the times of `odometry`; unchanged if there is no keyframe.
/// @throws std::invalid_argument if there are poses to correct that have no times.
[[nodiscard]] inline Trajectory corrected_trajectory(const Trajectory& odometry, std::span<const Keyframe> keyframes) {
  Trajectory corrected = odometry;
  if (keyframes.empty() || odometry.empty()) return corrected;
  if (!odometry.has_times()) throw std::invalid_argument("corrected_trajectory: the trajectory has no times");
  std::size_t next = 0;  // first keyframe later than the pose at hand
  for (std::size_t i = 0; i < odometry.size(); ++i) {
    const Timestamp time = odometry.times[i];
    while (next < keyframes.size() && keyframes[next].time <= time) ++next;
    const Keyframe& a = keyframes[next == 0 ? 0 : next - 1];
    SE3d pose = a.T_map_body * a.T_odom_body.inverse() * odometry.poses[i];
    if (next > 0 && next < keyframes.size()) {
      const Keyframe& b = keyframes[next];
      const SE3d raw = a.T_odom_body.inverse() * b.T_odom_body;
      const SE3d optimised = a.T_map_body.inverse() * b.T_map_body;
      const double share = to_seconds(time - a.time) / to_seconds(b.time - a.time);
      pose = pose * SE3d::exp(share * (raw.inverse() * optimised).log());
    }
    corrected.poses[i] = pose;
  }
  return corrected;
}

}  // namespace chainslam
