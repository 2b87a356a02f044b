#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
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
  [[nodiscard]] bool operator==(const PlanarSums&) const = default;
  [[nodiscard]] SE2<double> motion() const {
    const Eigen::Vector2d a = source / count, b = target / count;
    const double cosine = dot - count * a.dot(b), sine = cross - count * (a.x() * b.y() - a.y() * b.x());
    const SO2<double> R = SO2<double>::from_angle(std::atan2(sine, cosine));
    return {R, b - R * a};
  }
};

/// Matches that agree with a motion. Which ones are turned about as far is looked up as bits, in their order.
class PlanarAgreement {
 public:
  PlanarAgreement(std::span<const PlanarMatch> matches, double max_angle)
      : matches_(matches), max_angle_(std::min(max_angle, circle / 2)), words_(to_index((matches.size() + 63) / 64)) {
    bits_.resize(bins * static_cast<Offset>(words_), 0);
    for (std::size_t i = 0; i < matches.size(); ++i) {
      turned_.push_back(std::remainder(matches[i].turned, circle));
      if (!std::isfinite(turned_.back())) continue;
      bits_[first_word(bin(turned_.back())) + static_cast<Offset>(i / 64)] |= std::uint64_t{1} << (i % 64);
    }
  }

  /// Sums over matches that `T` brings together within `distance`, and `per_metre` more for each metre from `center`.
  [[nodiscard]] PlanarSums sums(const SE2<double>& T, double distance, double per_metre,
                                const Eigen::Vector2d& center) const {
    PlanarSums sums;
    const double turn = T.rotation().angle();
    constexpr double slack = 1e-6;  // for rounding
    const Offset low = bin(turn - max_angle_ - slack);
    const Offset high = std::min(bin(turn + max_angle_ + slack), low + bins - 1);
    for (Index word = 0; word < words_; ++word) {
      std::uint64_t near = 0;
      for (Offset one = low; one <= high; ++one) near |= bits_[first_word(one) + word];
      for (; near != 0; near &= near - 1) {
        const Offset i = 64 * static_cast<Offset>(word) + std::countr_zero(near);
        const double angle = std::abs(turned_[i] - turn);
        if (std::min(angle, circle - angle) > max_angle_) continue;
        const PlanarMatch& match = matches_[static_cast<std::size_t>(i)];
        const double allowed = distance + per_metre * (match.source - center).norm();
        if ((T * match.source - match.target).norm() <= allowed) sums.add(match);
      }
    }
    return sums;
  }

 private:
  static constexpr double circle = 2 * std::numbers::pi;
  static constexpr Offset bins = 64;
  /// Of an angle, counted on beyond the circle.
  [[nodiscard]] static Offset bin(double angle) {
    return static_cast<Offset>(std::floor(angle * (static_cast<double>(bins) / circle)));
  }
  [[nodiscard]] Offset first_word(Offset bin) const { return (bin & (bins - 1)) * words_; }

  std::span<const PlanarMatch> matches_;
  double max_angle_;
  Index words_;                ///< of a bin
  Table<std::uint64_t> bits_;  ///< of each bin: which matches lie in it
  Table<double> turned_;       ///< within half a circle: what is left of a difference needs no division
};

}  // namespace detail

/// Finds the motion that most matches agree on.
///
/// A match with directions is a hypothesis by itself, so all are tried and nothing is left to chance. Each is refined
/// by least squares over those that agree with it.
/// @returns the identity without inliers if no three matches agree.
/// @throws std::invalid_argument if an option makes no sense.
[[nodiscard]] inline PlanarConsensus planar_consensus(std::span<const PlanarMatch> matches,
                                                      const PlanarConsensusOptions& options = {}) {
  if (!(options.max_distance > 0 && options.max_angle > 0 && options.max_per_metre >= 0))
    throw std::invalid_argument("planar_consensus: max_distance and max_angle must be positive");
  constexpr int refinements = 3;
  const detail::PlanarAgreement agreement(matches, options.max_angle);
  PlanarConsensus best;
  detail::Table<detail::PlanarSums> tried;  // what agreed with a seed; from the same matches the same motion follows
  for (const PlanarMatch& seed : matches) {
    if (!std::isfinite(seed.turned)) continue;
    const SO2<double> R = SO2<double>::from_angle(seed.turned);
    const SE2<double> T(R, seed.target - R * seed.source);
    detail::PlanarSums sums = agreement.sums(T, 2 * options.max_distance, options.max_per_metre, seed.source);
    if (sums.count < 3 || std::find(tried.begin(), tried.end(), sums) != tried.end()) continue;
    tried.push_back(sums);
    for (int k = 0; k < refinements && sums.count >= 3; ++k) {
      const detail::PlanarSums before = sums;
      sums = agreement.sums(sums.motion(), options.max_distance, 0, seed.source);
      if (sums == before) break;
    }
    if (sums.count >= 3 && sums.count > best.inliers) best = {sums.motion(), sums.count};
  }
  return best;
}

}  // namespace chainslam
