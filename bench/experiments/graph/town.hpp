#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/slam/georeference.hpp"
#include "graph/sampled_drives.hpp"

namespace chainslam::experiments {

/// A session of a drawn world: one of the measured drives, moved to where it takes place.
struct Visit {
  std::size_t drive = 0;
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();  ///< in the frame of the truth, metres
};

/// How sessions are spread.
struct TownOptions {
  Index passes = 0;       ///< sessions at one place at most; 0: all take place where they were measured
  double spacing = 0.75;  ///< of the centres of neighbouring places, of the drives' extent: below 1 they share ground
};

namespace detail {

/// Places of a square grid in the order of a spiral, so that a town grows on all sides.
inline Eigen::Vector3d on_spiral(Index place) {
  int x = 0, y = 0, dx = 1, dy = 0;
  for (Index left = place, length = 1, side = 0; left > 0; ++side, length += side % 2 == 0 ? 1 : 0) {
    const auto steps = static_cast<int>(std::min(left, length));
    x += steps * dx;
    y += steps * dy;
    left -= static_cast<Index>(steps);
    std::swap(dx, dy);
    dx = -dx;
  }
  return {static_cast<double>(x), static_cast<double>(y), 0.0};
}

/// Of all drives together along the larger of both horizontal axes, metres.
inline double extent(const std::vector<MeasuredDrive>& drives) {
  Eigen::Vector3d least = drives.front().truth.poses.front().translation(), most = least;
  for (const MeasuredDrive& drive : drives)
    for (const SE3d& pose : drive.truth.poses) {
      least = least.cwiseMin(pose.translation());
      most = most.cwiseMax(pose.translation());
    }
  return (most - least).head<2>().maxCoeff();
}

}  // namespace detail

/// Where the sessions of a town drive. With every so many sessions a place is opened next to the others; each session
/// drives one that is drawn from all that are open and not full. So the town is driven everywhere all the time, a third
/// of it has still to come, and what lies around a keyframe stays as dense however large the town becomes.
inline std::vector<Visit> visits(std::size_t sessions, const std::vector<MeasuredDrive>& drives,
                                 const TownOptions& options, Rng rng) {
  const double spacing = options.spacing * detail::extent(drives);
  std::vector<Visit> visits;
  std::vector<Index> free_passes;  // of each open place
  for (std::size_t session = 0; session < sessions; ++session) {
    Visit& visit = visits.emplace_back();
    visit.drive = session % drives.size();
    if (options.passes <= 0) continue;
    const auto open = static_cast<std::size_t>(1.5 * static_cast<double>(session) / options.passes) + 1;
    if (free_passes.size() < open) free_passes.resize(open, options.passes);
    const auto count = static_cast<Index>(free_passes.size());
    Index place = rng.uniform_index(count);
    while (free_passes[static_cast<std::size_t>(place)] == 0) place = rng.uniform_index(count);
    --free_passes[static_cast<std::size_t>(place)];
    visit.offset = spacing * detail::on_spiral(place);
  }
  return visits;
}

/// How the truth's axes lie in the Earth's frame, upright. Nothing if the fixes of the drives do not say.
inline std::optional<Eigen::Matrix3d> R_ecef_truth(const std::vector<MeasuredDrive>& drives) {
  std::vector<FixedPosition> fixed;
  const auto take = [&](const MeasuredDrive& drive, const std::vector<GnssFix>& fixes) {
    for (const GnssFix& fix : fixes)
      if (const auto pose = pose_at(drive.truth, fix.time, seconds(2.0)); pose && is_usable(fix, {}))
        fixed.push_back({pose->translation(), fix.position_ecef});
  };
  for (const MeasuredDrive& drive : drives) {
    for (const Leg& leg : drive.legs) take(drive, leg.fixes);
    take(drive, drive.last_fixes);
  }
  const std::optional<SE3d> T_truth_ecef = georeference(fixed, {});
  if (!T_truth_ecef) return std::nullopt;
  constexpr double polar_flattening = 1 - 6.69437999014e-3;  // squared, WGS 84
  const Eigen::Vector3d& somewhere = fixed.front().ecef;
  const Eigen::Vector3d up(somewhere.x(), somewhere.y(), somewhere.z() / polar_flattening);
  const Eigen::Matrix3d R_truth_ecef = T_truth_ecef->rotation().matrix();
  const Eigen::Vector3d leaning = (R_truth_ecef * up).normalized();
  const Eigen::Vector3d upright = std::copysign(1.0, leaning.z()) * Eigen::Vector3d::UnitZ();
  const Eigen::Quaterniond levelled = Eigen::Quaterniond::FromTwoVectors(leaning, upright);
  return (levelled.toRotationMatrix() * R_truth_ecef).transpose();
}

/// The same drive somewhere else, with the same errors. Without fixes if it is not known how the frames lie.
inline MeasuredDrive moved(MeasuredDrive drive, const Eigen::Vector3d& offset,
                           const std::optional<Eigen::Matrix3d>& R_ecef_truth) {
  if (offset.isZero(0)) return drive;
  const auto move = [&](SE3d& pose) { pose = SE3d(pose.rotation(), pose.translation() + offset); };
  const auto move_fixes = [&](std::vector<GnssFix>& fixes) {
    if (!R_ecef_truth) fixes.clear();
    for (GnssFix& fix : fixes) fix.position_ecef += *R_ecef_truth * offset;
  };
  for (SE3d& pose : drive.truth.poses) move(pose);
  for (Leg& leg : drive.legs) {
    for (MeasuredFrame& frame : leg.frames) move(frame.T_truth_body);
    move_fixes(leg.fixes);
  }
  move_fixes(drive.last_fixes);
  return drive;
}

}  // namespace chainslam::experiments
