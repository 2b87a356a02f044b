#pragma once

#include <algorithm>
#include <numeric>
#include <optional>
#include <span>
#include <stdexcept>
#include <vector>

#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/concepts.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// Poses along a path, in the order of time: `poses[i]` is T_reference_body at `times[i]`.
///
/// `times` is empty where the source states none (KITTI's files); poses then count by their position.
struct Trajectory {
  std::vector<Timestamp> times;  ///< in the order of the poses, or empty
  std::vector<SE3d> poses;       ///< T_reference_body

  [[nodiscard]] std::size_t size() const { return poses.size(); }  ///< number of poses
  [[nodiscard]] bool empty() const { return poses.empty(); }       ///< whether there is nothing in it
  /// Whether there is a time for each pose.
  [[nodiscard]] bool has_times() const { return !poses.empty() && times.size() == poses.size(); }
};

/// Length of the polygon through the positions up to each of them, metres: as many values as poses, the first is 0.
[[nodiscard]] inline std::vector<double> path_lengths(std::span<const SE3d> poses) {
  std::vector<double> lengths(poses.size(), 0.0);
  for (std::size_t i = 1; i < poses.size(); ++i)
    lengths[i] = lengths[i - 1] + (poses[i].translation() - poses[i - 1].translation()).norm();
  return lengths;
}

/// Length of the polygon through all positions, metres.
[[nodiscard]] inline double path_length(const Trajectory& trajectory) {
  return trajectory.empty() ? 0.0 : path_lengths(trajectory.poses).back();
}

/// Position of the first time that is not later than the one before it; nothing if times increase throughout.
[[nodiscard]] inline std::optional<Index> first_disorder(std::span<const Timestamp> times) {
  const auto found =
      std::adjacent_find(times.begin(), times.end(), [](Timestamp before, Timestamp after) { return after <= before; });
  if (found == times.end()) return std::nullopt;
  return to_index(found - times.begin() + 1);
}

/// Position of the first pose with a number that is not finite; nothing if all are.
[[nodiscard]] inline std::optional<Index> first_not_finite(std::span<const SE3d> poses) {
  const auto found = std::find_if_not(poses.begin(), poses.end(), [](const SE3d& pose) {
    return is_finite(pose.translation()) && is_finite(pose.rotation().quaternion().coeffs());
  });
  if (found == poses.end()) return std::nullopt;
  return to_index(found - poses.begin());
}

/// The poses at `indices`, in that order, with their times if there are any.
[[nodiscard]] inline Trajectory subset(const Trajectory& trajectory, std::span<const Index> indices) {
  Trajectory result;
  for (const Index index : indices) {
    result.poses.push_back(trajectory.poses[static_cast<std::size_t>(index)]);
    if (trajectory.has_times()) result.times.push_back(trajectory.times[static_cast<std::size_t>(index)]);
  }
  return result;
}

/// The trajectory in the order of its times. Of poses with one time the first is kept.
/// @throws std::invalid_argument if it has no times.
[[nodiscard]] inline Trajectory sorted_by_time(const Trajectory& trajectory) {
  if (trajectory.empty()) return {};
  if (!trajectory.has_times()) throw std::invalid_argument("sorted_by_time: the trajectory has no times");
  const auto time = [&](Index i) { return trajectory.times[static_cast<std::size_t>(i)]; };
  std::vector<Index> order(static_cast<std::size_t>(to_index(trajectory.size(), "poses")));
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](Index a, Index b) { return time(a) < time(b); });
  order.erase(std::unique(order.begin(), order.end(), [&](Index a, Index b) { return time(a) == time(b); }),
              order.end());
  return subset(trajectory, order);
}

/// The same path seen from another frame: T_new_reference * pose for each pose.
[[nodiscard]] inline Trajectory transformed(const SE3d& T_new_reference, Trajectory trajectory) {
  for (SE3d& pose : trajectory.poses) pose = T_new_reference * pose;
  return trajectory;
}

/// The pose at a time, on the geodesic between its two neighbours. Nothing outside the trajectory's span, and nothing
/// where the neighbours are more than `max_gap` apart; never extrapolated.
///
/// @param trajectory  with times that do not go back; of poses with one time the first counts. O(log n).
[[nodiscard]] inline std::optional<SE3d> pose_at(const Trajectory& trajectory, Timestamp time, Duration max_gap) {
  if (!trajectory.has_times()) return std::nullopt;
  const auto& times = trajectory.times;
  const auto after = std::lower_bound(times.begin(), times.end(), time);
  if (after == times.end()) return std::nullopt;
  const auto i = static_cast<std::size_t>(after - times.begin());
  if (*after == time) return trajectory.poses[i];
  if (i == 0 || *after - times[i - 1] > max_gap) return std::nullopt;
  const double fraction = to_seconds(time - times[i - 1]) / to_seconds(*after - times[i - 1]);
  return interpolate(trajectory.poses[i - 1], trajectory.poses[i], fraction);
}

}  // namespace chainslam
