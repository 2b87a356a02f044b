#pragma once

#include <algorithm>
#include <chrono>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam {

/// Positions of two poses that belong together.
struct Match {
  Index reference = 0;                                           ///< position in the reference
  Index estimate = 0;                                            ///< position in the estimate
  friend bool operator==(const Match&, const Match&) = default;  ///< whether all members are equal
};

/// Poses of one trajectory that found no partner in the other, by reason.
struct UnmatchedCounts {
  Index before = 0;   ///< earlier than all of the other, by more than the allowed difference
  Index after = 0;    ///< later than all of the other
  Index too_far = 0;  ///< nothing near enough in between
  Index taken = 0;    ///< what would have been near enough belongs to a nearer pose

  [[nodiscard]] Index total() const { return before + after + too_far + taken; }     ///< of all reasons
  friend bool operator==(const UnmatchedCounts&, const UnmatchedCounts&) = default;  ///< whether all members are equal
};

/// Which poses of two trajectories belong together, in the order of time, and what is left over.
struct Association {
  std::vector<Match> matches;      ///< in the order of time
  UnmatchedCounts reference;       ///< what is left over of the reference
  UnmatchedCounts estimate;        ///< what is left over of the estimate
  Duration largest_difference{0};  ///< of the times of a match
};

/// When two times belong together.
struct TimeAssociationOptions {
  Duration max_difference = std::chrono::milliseconds(10);  ///< evo's default
  /// evo lets two poses of the shorter trajectory share one of the longer; here only the nearer keeps it, unless false.
  bool one_to_one = true;
};

/// Two trajectories of one length whose i-th poses belong together.
struct MatchedTrajectories {
  Trajectory reference;  ///< one for each pose of `estimate`
  Trajectory estimate;   ///< one for each pose of `reference`
};

namespace detail {

inline void require_times(const Trajectory& trajectory, const char* name) {
  if (trajectory.empty()) return;
  if (!trajectory.has_times())
    throw std::invalid_argument(std::string("association by time: the ") + name + " has no times; associate by index");
  const auto back = std::is_sorted_until(trajectory.times.begin(), trajectory.times.end());
  if (back != trajectory.times.end())
    throw std::invalid_argument(std::string("association by time: time ") +
                                std::to_string(back - trajectory.times.begin()) + " of the " + name +
                                " is earlier than the one before; use sorted_by_time");
}

inline Duration magnitude(Duration duration) { return duration < Duration::zero() ? -duration : duration; }

/// Position of the time nearest to `time`, the earlier of two at one distance. `times` is sorted and not empty.
inline Index nearest_time(std::span<const Timestamp> times, Timestamp time) {
  const auto after = std::lower_bound(times.begin(), times.end(), time);
  const auto i = after - times.begin();
  if (after == times.begin()) return 0;
  if (after == times.end() || time - times[static_cast<std::size_t>(i - 1)] <= *after - time) return to_index(i - 1);
  return to_index(i);
}

/// For each time of the shorter list the nearest of the longer, or -1 if that is too far.
inline std::vector<Index> nearest_partners(std::span<const Timestamp> shorter, std::span<const Timestamp> longer,
                                           Duration max_difference) {
  std::vector<Index> partners;
  for (const Timestamp time : shorter) {
    const Index j = nearest_time(longer, time);
    partners.push_back(magnitude(longer[static_cast<std::size_t>(j)] - time) <= max_difference ? j : -1);
  }
  return partners;
}

/// Of several in a row that chose the same partner, leaves it to the nearest, the earlier of two at one distance.
inline void keep_nearest(std::span<const Timestamp> shorter, std::span<const Timestamp> longer,
                         std::vector<Index>& partners) {
  const auto distance = [&](std::size_t i) {
    return magnitude(longer[static_cast<std::size_t>(partners[i])] - shorter[i]);
  };
  std::size_t owner = 0;
  for (std::size_t i = 1; i < partners.size(); ++i) {
    if (partners[i] < 0) continue;
    if (partners[owner] != partners[i]) {
      owner = i;
    } else if (distance(i) < distance(owner)) {
      partners[owner] = -1;
      owner = i;
    } else {
      partners[i] = -1;
    }
  }
}

/// Says why each time that is not matched is not.
inline UnmatchedCounts unmatched(std::span<const Timestamp> times, std::span<const Timestamp> others,
                                 const std::vector<bool>& matched, Duration max_difference) {
  UnmatchedCounts counts;
  for (std::size_t i = 0; i < times.size(); ++i) {
    if (matched[i]) continue;
    if (others.empty()) {
      ++counts.too_far;
      continue;
    }
    const Timestamp nearest = others[static_cast<std::size_t>(nearest_time(others, times[i]))];
    if (magnitude(nearest - times[i]) <= max_difference)
      ++counts.taken;
    else if (times[i] < others.front())
      ++counts.before;
    else if (times[i] > others.back())
      ++counts.after;
    else
      ++counts.too_far;
  }
  return counts;
}

}  // namespace detail

/// Associates by time as evo does: each pose of the shorter trajectory takes the nearest of the longer, if that is no
/// farther than `max_difference`. O(n log n).
/// @throws std::invalid_argument if a trajectory has no times, or times that go back; they may repeat.
[[nodiscard]] inline Association associate_by_time(const Trajectory& reference, const Trajectory& estimate,
                                                   const TimeAssociationOptions& options = {}) {
  detail::require_times(reference, "reference");
  detail::require_times(estimate, "estimate");
  const bool estimate_longer = estimate.size() > reference.size();
  const auto& shorter = estimate_longer ? reference.times : estimate.times;
  const auto& longer = estimate_longer ? estimate.times : reference.times;
  Association result;
  std::vector<bool> shorter_matched(shorter.size()), longer_matched(longer.size());
  if (!longer.empty()) {
    auto partners = detail::nearest_partners(shorter, longer, options.max_difference);
    if (options.one_to_one) detail::keep_nearest(shorter, longer, partners);
    for (std::size_t i = 0; i < partners.size(); ++i) {
      if (partners[i] < 0) continue;
      const auto j = static_cast<std::size_t>(partners[i]);
      const Index here = to_index(i, "poses");
      result.matches.push_back(estimate_longer ? Match{here, partners[i]} : Match{partners[i], here});
      shorter_matched[i] = longer_matched[j] = true;
      result.largest_difference = std::max(result.largest_difference, detail::magnitude(longer[j] - shorter[i]));
    }
  }
  auto& of_shorter = estimate_longer ? result.reference : result.estimate;
  auto& of_longer = estimate_longer ? result.estimate : result.reference;
  of_shorter = detail::unmatched(shorter, longer, shorter_matched, options.max_difference);
  of_longer = detail::unmatched(longer, shorter, longer_matched, options.max_difference);
  return result;
}

/// Associates the i-th pose with the i-th; what the longer trajectory has more is left over as `after`.
[[nodiscard]] inline Association associate_by_index(const Trajectory& reference, const Trajectory& estimate) {
  Association result;
  const Index references = to_index(reference.size(), "poses"), estimates = to_index(estimate.size(), "poses");
  const Index count = std::min(references, estimates);
  for (Index i = 0; i < count; ++i) result.matches.push_back({i, i});
  result.reference.after = references - count;
  result.estimate.after = estimates - count;
  return result;
}

/// The poses that an association joins.
[[nodiscard]] inline MatchedTrajectories matched(const Trajectory& reference, const Trajectory& estimate,
                                                 const Association& association) {
  std::vector<Index> references, estimates;
  for (const Match& match : association.matches) {
    references.push_back(match.reference);
    estimates.push_back(match.estimate);
  }
  return {subset(reference, references), subset(estimate, estimates)};
}

/// Poses of the estimate with the reference interpolated to their times, and the estimate's poses left over: before or
/// after the reference's span, or `too_far` in a gap of the reference longer than `max_gap`.
struct InterpolatedMatch {
  MatchedTrajectories trajectories;  ///< of one length
  UnmatchedCounts estimate;          ///< what is left over of the estimate
};

/// @throws std::invalid_argument if a trajectory has no times, or times that go back; they may repeat.
[[nodiscard]] inline InterpolatedMatch match_interpolated(const Trajectory& reference, const Trajectory& estimate,
                                                          Duration max_gap) {
  detail::require_times(reference, "reference");
  detail::require_times(estimate, "estimate");
  InterpolatedMatch result;
  for (std::size_t i = 0; i < estimate.size(); ++i) {
    const Timestamp time = estimate.times[i];
    if (const auto pose = pose_at(reference, time, max_gap)) {
      result.trajectories.reference.times.push_back(time);
      result.trajectories.reference.poses.push_back(*pose);
      result.trajectories.estimate.times.push_back(time);
      result.trajectories.estimate.poses.push_back(estimate.poses[i]);
    } else if (!reference.empty() && time < reference.times.front()) {
      ++result.estimate.before;
    } else if (!reference.empty() && time > reference.times.back()) {
      ++result.estimate.after;
    } else {
      ++result.estimate.too_far;
    }
  }
  return result;
}

}  // namespace chainslam
