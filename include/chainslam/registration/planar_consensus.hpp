#pragma once

#include <Eigen/Core>
#include <cmath>
#include <limits>
#include <numbers>
#include <span>
#include <stdexcept>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se2.hpp"

namespace chainslam {

/// A point of the plane with a direction, seen in two frames.
struct PlanarMatch {
  Eigen::Vector2d source{0, 0};  ///< metres
  Eigen::Vector2d target{0, 0};  ///< metres
  double turned = 0;             ///< radians: direction in the target's frame minus that in the source's
};

/// When matches agree on one motion.
struct PlanarConsensusOptions {
  double max_distance = 1.5;    ///< metres between the two of a match that the pose brings together
  double max_angle = 0.35;      ///< radians between a match's directions, turned by the pose
  double max_per_metre = 0.05;  ///< metres that a pose by one match alone may be off for each metre from it
};

/// The motion of the plane that most matches agree on.
struct PlanarConsensus {
  SE2<double> T_target_source;  ///< the motion that most matches agree on
  Index inliers = 0;            ///< matches that it brings together
};

namespace detail {

/// Sums over matches, of which the least-squares motion follows (Umeyama 1991, in the plane).
struct PlanarSums {
  Index count = 0;
  Eigen::Vector2d source = Eigen::Vector2d::Zero(), target = Eigen::Vector2d::Zero();
  double dot = 0, cross = 0;

  void add(const PlanarMatch& match) {
    ++count;
    source += match.source;
    target += match.target;
    dot += match.source.dot(match.target);
    cross += match.source.x() * match.target.y() - match.source.y() * match.target.x();
  }
  [[nodiscard]] SE2<double> motion() const {
    const Eigen::Vector2d a = source / count, b = target / count;
    const double cosine = dot - count * a.dot(b), sine = cross - count * (a.x() * b.y() - a.y() * b.x());
    const SO2<double> R = SO2<double>::from_angle(std::atan2(sine, cosine));
    return {R, b - R * a};
  }
};

}  // namespace detail

/// Finds the motion that most matches agree on.
///
/// A match with directions is a hypothesis by itself, so all are tried and nothing is left to chance. Each is refined
/// by least squares over those that agree with it.
/// @returns the identity without inliers if no three matches agree.
/// @throws std::invalid_argument if an option makes no sense.
[[nodiscard]] [[gnu::cold]] inline PlanarConsensus planar_consensus(std::span<const PlanarMatch> matches,
                                                                    const PlanarConsensusOptions& options = {}) {
  if (!(options.max_distance > 0 && options.max_angle > 0 && options.max_per_metre >= 0))
    throw std::invalid_argument("planar_consensus: max_distance and max_angle must be positive");
  constexpr int refinements = 3;
  const auto agreeing = [&](const SE2<double>& T, double distance, double per_metre, const Eigen::Vector2d& center) {
    detail::PlanarSums sums;
    for (const PlanarMatch& match : matches) {
      const double angle = std::remainder(match.turned - T.rotation().angle(), 2 * std::numbers::pi);
      const double allowed = distance + per_metre * (match.source - center).norm();
      const Eigen::Vector2d off = T * match.source - match.target;
      if (std::abs(angle) <= options.max_angle && off.norm() <= allowed) sums.add(match);
    }
    return sums;
  };
  PlanarConsensus best;
  for (const PlanarMatch& seed : matches) {
    const SO2<double> R = SO2<double>::from_angle(seed.turned);
    SE2<double> T(R, seed.target - R * seed.source);
    detail::PlanarSums sums = agreeing(T, 2 * options.max_distance, options.max_per_metre, seed.source);
    for (int k = 0; k < refinements && sums.count >= 3; ++k) {
      T = sums.motion();
      sums = agreeing(T, options.max_distance, 0, seed.source);
    }
    if (sums.count >= 3 && sums.count > best.inliers) best = {sums.motion(), sums.count};
  }
  return best;
}

}  // namespace chainslam
