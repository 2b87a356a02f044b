#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/features/detail/distance_tiles.hpp"
#include "chainslam/features/detail/nearest_features.hpp"

namespace chainslam {

/// Two points that look alike: an index in the source, an index in the target.
struct FeatureMatch {
  Index source = -1;  ///< index of the source point
  Index target = -1;  ///< index of the target point
  /// How much nearer the match is than the next best, of the source's point or the target's, whichever is the more
  /// doubtful: the quotient of the distances, in [0, 1], small for a match that stands out; 1 where it was not asked
  /// for.
  float ratio = 1;

  /// The same two points.
  friend bool operator==(const FeatureMatch& a, const FeatureMatch& b) {
    return a.source == b.source && a.target == b.target;
  }
};

/// Which features are matched.
struct MatchOptions {
  bool mutual = true;       ///< keep a pair only if each is the other's nearest
  double max_ratio = 1;     ///< keep a pair only if its `ratio` is not larger (Lowe 2004)
  Index max_matches = 0;    ///< keep so many with the least `ratio`; 0: all
  bool by_quality = false;  ///< order by `ratio`, the least first; else by the source's index
};

namespace detail {

/// The quotient of the distances of the nearest and the next; 1 if there is no other.
[[nodiscard]] inline double distance_ratio(const NearestTable& table, Index query) {
  const NearestPair& pair = table[query];
  if (pair.second < 0) return 1;
  const double next = table.squared_distance(query, pair.second);
  return next > 0 ? std::min(1.0, std::sqrt(table.squared_distance(query, pair.best) / next)) : 1.0;
}

/// Cuts off the worst, and orders as asked.
inline void keep_best(std::vector<FeatureMatch>& matches, const MatchOptions& options) {
  const auto sort = [&](bool by_ratio) {  // equal ones stay in their order
    Table<Ranked> order;
    for (const FeatureMatch& match : matches)
      order.push_back({by_ratio ? static_cast<double>(match.ratio) : match.source, static_cast<Index>(order.size())});
    sort_ranked(order.all());
    std::vector<FeatureMatch> sorted(matches.size());
    for (std::size_t k = 0; k < sorted.size(); ++k) sorted[k] = matches[static_cast<std::size_t>(order.all()[k].index)];
    matches.swap(sorted);
  };
  const auto limit = static_cast<std::size_t>(options.max_matches);
  const bool cut = limit > 0 && matches.size() > limit;
  sort(false);
  if (cut || options.by_quality) sort(true);
  if (cut) matches.resize(limit);
  if (cut && !options.by_quality) sort(false);
}

}  // namespace detail

/// Pairs each source feature with the nearest target feature, and keeps the pairs that are nearest both ways.
///
/// Exact, as if all were compared with all: the distances that may matter are taken once for both directions. Of equal
/// ones the lowest index wins.
/// @param source, target  d x n and d x m, one feature a column; columns of zeros or not finite are never matched.
/// @returns pairs in the order asked for, the same for any executor.
/// @throws std::invalid_argument if the features differ in length or an option makes no sense.
template <Executor Exec = Serial>
[[nodiscard]] std::vector<FeatureMatch> match_features(const Eigen::Ref<const Eigen::MatrixXf>& source,
                                                       const Eigen::Ref<const Eigen::MatrixXf>& target,
                                                       const MatchOptions& options = {}, const Exec& executor = {}) {
  if (source.rows() != target.rows())
    throw std::invalid_argument("match_features: source and target features differ in length");
  if (!(options.max_ratio > 0 && options.max_ratio <= 1) || options.max_matches < 0)
    throw std::invalid_argument("match_features: max_ratio must be in (0, 1], max_matches not negative");
  (void)to_index(std::max(source.cols(), target.cols()), "features");
  const bool with_ratio = options.max_ratio < 1 || options.max_matches > 0 || options.by_quality;
  std::vector<float> center, direction;
  call_both(
      executor, [&] { center = detail::middle(target); }, [&] { direction = detail::spread(target); });
  detail::FeatureSet sources, targets;
  call_both(
      executor, [&] { sources = detail::FeatureSet(source, center, direction); },
      [&] { targets = detail::FeatureSet(target, center, direction); });
  const detail::NearestBothWays nearest = detail::nearest_both_ways(sources, targets, center, with_ratio, executor);
  std::vector<FeatureMatch> matches;
  for (Index k = 0; k < sources.size(); ++k) {
    const Index there = nearest.of_source[k].best;
    if (there < 0 || (options.mutual && nearest.of_target[there].best != k)) continue;
    FeatureMatch match{sources.index(k), targets.index(there)};
    if (with_ratio)
      match.ratio = static_cast<float>(
          std::max(detail::distance_ratio(nearest.of_source, k), detail::distance_ratio(nearest.of_target, there)));
    if (!(static_cast<double>(match.ratio) <= options.max_ratio)) continue;
    matches.push_back(match);
  }
  detail::keep_best(matches, options);
  return matches;
}

}  // namespace chainslam
