#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numeric>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/random.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam::lamm {

/// Which loops are dropped for contradicting odometry or the others.
struct LoopFilterOptions {
  double max_path_difference = 1.5;  ///< metres, within a session: between the loop's distance and odometry's
  double subset = 0.5;               ///< share of the loops of two sessions that a draw takes
  Index max_draws = 100'000;
  double min_spread = 1.0;   ///< metres: a draw whose mean distance from its centre is smaller ends the drawing
  Index few = 4;             ///< so many loops are taken together, without drawing
  double few_radius = 15.0;  ///< metres about the mean of few loops; 0 as released
  std::uint64_t seed = 1;
};

/// A sphere in which loops between two sessions put the start of one of them.
struct Agreement {
  Eigen::Vector3d center = Eigen::Vector3d::Zero();
  double radius = 0;

  [[nodiscard]] bool holds(const Eigen::Vector3d& p) const { return (p - center).norm() <= radius; }
};

namespace detail {

[[nodiscard]] inline Eigen::Vector3d mean_of(std::span<const Eigen::Vector3d> points, std::span<const Index> chosen) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const Index i : chosen) sum += points[static_cast<std::size_t>(i)];
  return sum / static_cast<double>(chosen.size());
}

/// Moves `count` elements to the front, each set of them as probable as any other.
inline void draw(std::vector<Index>& order, std::size_t count, Rng& rng) {
  for (std::size_t i = 0; i < count; ++i)
    std::swap(order[i], order[i + static_cast<std::size_t>(rng.uniform_index(to_index(order.size() - i)))]);
}

}  // namespace detail

/// What most of the points agree on: of random halves of them the one with the least mean distance from its mean, and
/// the largest distance in it. Few points are taken as they are.
[[nodiscard]] inline Agreement agreement(std::span<const Eigen::Vector3d> points, const LoopFilterOptions& options) {
  std::vector<Index> order(points.size());
  std::iota(order.begin(), order.end(), 0);
  if (points.empty()) return {};
  if (to_index(points.size()) <= options.few) return {detail::mean_of(points, order), options.few_radius};
  const auto count =
      std::max<std::size_t>(1, static_cast<std::size_t>(options.subset * static_cast<double>(points.size())));
  Rng rng(options.seed);
  Agreement best;
  double least = std::numeric_limits<double>::infinity();
  for (Index i = 0; i < options.max_draws && !(least < options.min_spread); ++i) {
    detail::draw(order, count, rng);
    const auto chosen = std::span(order).first(count);
    const Eigen::Vector3d center = detail::mean_of(points, chosen);
    double sum = 0, radius = 0;
    for (const Index k : chosen) {
      const double distance = (points[static_cast<std::size_t>(k)] - center).norm();
      sum += distance;
      radius = std::max(radius, distance);
    }
    const double spread = sum / static_cast<double>(count);
    if (!(spread < least)) continue;
    least = spread;
    best = {center, radius};
  }
  return best;
}

/// Whether a loop of one session closes about as long a distance as odometry went between its ends.
[[nodiscard]] inline bool agrees_with_odometry(const SE3d& T_target_source, const SE3d& T_odom_target,
                                               const SE3d& T_odom_source, const LoopFilterOptions& options) {
  const double odometry = (T_odom_source.translation() - T_odom_target.translation()).norm();
  return std::abs(T_target_source.translation().norm() - odometry) <= options.max_path_difference;
}

}  // namespace chainslam::lamm
