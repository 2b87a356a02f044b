#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <span>
#include <vector>

#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam::experiments {

/// A straight piece of road, by the ends of its centre line.
struct Street {
  Eigen::Vector3d begin, end;  ///< in the truth's frame, metres
  std::size_t sessions = 0;    ///< that drive most of it
  double driven = 0;           ///< shares of it that sessions drive, added up
};

struct StreetOptions {
  double length = 50.0;       ///< metres
  double gate = 12.0;         ///< metres from the centre line within which a keyframe counts
  double straightness = 2.0;  ///< metres that a drive may leave the line
  double covered = 0.6;       ///< share of the line that a session has to drive
  std::size_t count = 4;
};

/// A position along a street's line and beside it, metres.
struct OnStreet {
  double along = 0, beside = 0;
};

inline OnStreet on_street(const Street& street, const Eigen::Vector3d& position) {
  const Eigen::Vector2d line = (street.end - street.begin).head<2>(), way = (position - street.begin).head<2>();
  const double length = line.norm();
  return {line.dot(way) / length, std::abs(line.x() * way.y() - line.y() * way.x()) / length};
}

inline double length_of(const Street& street) { return (street.end - street.begin).head<2>().norm(); }

inline bool is_on(const Street& street, const Eigen::Vector3d& position, double gate) {
  const OnStreet at = on_street(street, position);
  return at.along >= 0 && at.along <= length_of(street) && at.beside <= gate;
}

namespace detail {

/// The share of the line's pieces of 5 m that a session's keyframes lie in.
inline double driven_share(const Trajectory& drive, const Street& street, const StreetOptions& options) {
  constexpr double piece = 5.0;
  const auto pieces = static_cast<std::size_t>(std::ceil(length_of(street) / piece));
  std::vector<bool> seen(pieces, false);
  for (const SE3d& pose : drive.poses)
    if (is_on(street, pose.translation(), options.gate)) {
      const auto at = static_cast<std::size_t>(on_street(street, pose.translation()).along / piece);
      // A keyframe stands for the way to its neighbours, which may be 10 m.
      for (std::size_t k = at > 0 ? at - 1 : 0; k < std::min(pieces, at + 2); ++k) seen[k] = true;
    }
  return static_cast<double>(std::ranges::count(seen, true)) / static_cast<double>(pieces);
}

/// The straight piece that a drive begins at a keyframe, if it is straight.
inline bool piece_at(const Trajectory& drive, std::size_t first, const StreetOptions& options, Street& street) {
  std::size_t last = first;
  const Eigen::Vector3d& begin = drive.poses[first].translation();
  while (last + 1 < drive.poses.size() && (drive.poses[last].translation() - begin).norm() < options.length) ++last;
  if ((drive.poses[last].translation() - begin).norm() < options.length) return false;
  street.begin = begin;
  street.end = drive.poses[last].translation();
  return std::all_of(
      drive.poses.begin() + static_cast<std::ptrdiff_t>(first), drive.poses.begin() + static_cast<std::ptrdiff_t>(last),
      [&](const SE3d& pose) { return on_street(street, pose.translation()).beside <= options.straightness; });
}

}  // namespace detail

/// The streets that are driven most, by many sessions, apart from each other; from true paths alone, so that they are
/// the same for every map.
/// @param drives  T_truth_body at the keyframes of each session.
inline std::vector<Street> chosen_streets(std::span<const Trajectory> drives, const StreetOptions& options) {
  std::vector<Street> found;
  for (const Trajectory& drive : drives)
    for (std::size_t i = 0; i < drive.poses.size(); ++i) {
      Street street;
      if (!detail::piece_at(drive, i, options, street)) continue;
      for (const Trajectory& one : drives) {
        const double share = detail::driven_share(one, street, options);
        street.driven += share;
        street.sessions += share >= options.covered ? 1 : 0;
      }
      found.push_back(street);
    }
  std::ranges::stable_sort(found, std::ranges::greater{}, &Street::driven);
  std::vector<Street> chosen;
  for (const Street& street : found) {
    const Eigen::Vector3d middle = 0.5 * (street.begin + street.end);
    const bool known = std::ranges::any_of(chosen, [&](const Street& other) {
      return (0.5 * (other.begin + other.end) - middle).norm() < options.length;
    });
    if (!known) chosen.push_back(street);
    if (chosen.size() == options.count) break;
  }
  return chosen;
}

}  // namespace chainslam::experiments
