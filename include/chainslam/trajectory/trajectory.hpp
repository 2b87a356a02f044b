#pragma once

#include <vector>

#include "chainslam/core/timestamp.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// Poses along a path, in the order of time: `poses[i]` is T_reference_body at `times[i]`.
///
/// `times` is empty where the source states none (KITTI's files); poses then count by their position.
struct Trajectory {
  std::vector<Timestamp> times;
  std::vector<SE3d> poses;

  [[nodiscard]] std::size_t size() const { return poses.size(); }
  [[nodiscard]] bool empty() const { return poses.empty(); }
  [[nodiscard]] bool has_times() const { return !poses.empty() && times.size() == poses.size(); }
};

/// Length of the polygon through all positions, metres.
[[nodiscard]] inline double path_length(const Trajectory& trajectory) {
  double length = 0;
  for (std::size_t i = 1; i < trajectory.size(); ++i)
    length += (trajectory.poses[i].translation() - trajectory.poses[i - 1].translation()).norm();
  return length;
}

}  // namespace chainslam
