#pragma once

#include <algorithm>
#include <optional>

#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/interpolate.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam {

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
