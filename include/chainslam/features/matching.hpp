#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstddef>
#include <limits>
#include <span>
#include <stdexcept>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/finite.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam {

/// Two points that look alike: an index in the source, an index in the target.
struct FeatureMatch {
  Index source = -1;
  Index target = -1;
  friend bool operator==(const FeatureMatch&, const FeatureMatch&) = default;
};

struct MatchOptions {
  bool mutual = true;  ///< keep a pair only if each is the other's nearest
};

namespace detail {

/// Features that say something, side by side, with their indices and |f|^2 / 2.
struct FeatureSet {
  Eigen::MatrixXf columns;
  std::vector<Index> indices;
  Eigen::VectorXf half_squared_norms;

  [[nodiscard]] Index size() const { return static_cast<Index>(indices.size()); }
};

/// The features at `candidates`, ascending, without those that are all zeros or not finite.
[[nodiscard]] inline FeatureSet usable_features(const Eigen::Ref<const Eigen::MatrixXf>& features,
                                                std::span<const Index> candidates) {
  FeatureSet set;
  for (const Index i : candidates) {
    const float squared_norm = features.col(i).squaredNorm();
    if (is_finite(squared_norm) && squared_norm > 0) set.indices.push_back(i);
  }
  set.columns.resize(features.rows(), set.size());
  set.half_squared_norms.resize(set.size());
  for (Index k = 0; k < set.size(); ++k) {
    set.columns.col(k) = features.col(set.indices[static_cast<std::size_t>(k)]);
    set.half_squared_norms[k] = 0.5F * set.columns.col(k).squaredNorm();
  }
  return set;
}

[[nodiscard]] inline FeatureSet usable_features(const Eigen::Ref<const Eigen::MatrixXf>& features) {
  std::vector<Index> all(static_cast<std::size_t>(to_index(features.cols(), "features")));
  for (std::size_t i = 0; i < all.size(); ++i) all[i] = static_cast<Index>(i);
  return usable_features(features, all);
}

/// The nearest target feature found so far for one query.
class NearestFeature {
 public:
  /// @param rounding  more than what the products' rounding can do to a squared distance.
  NearestFeature(const float* query, float half_squared_norm, double rounding)
      : query_(query), offset_(half_squared_norm - rounding) {}

  [[nodiscard]] Index index() const { return index_; }

  /// Offers a block of targets, beginning with number `first`.
  /// @param products  of the targets with the query; become |t|^2 / 2 - t . q, half the squared distance but for a
  ///                  constant.
  void offer(const FeatureSet& targets, Index first, Eigen::Ref<Eigen::VectorXf> products) {
    products = targets.half_squared_norms.segment(first, products.size()) - products;
    if (!(static_cast<double>(products.minCoeff()) <= limit_)) return;
    for (Eigen::Index k = 0; k < products.size(); ++k)
      if (static_cast<double>(products[k]) <= limit_) compare(targets, first + static_cast<Index>(k));
  }

 private:
  /// The distance itself, in double: which target is nearest does not depend on how products are rounded.
  void compare(const FeatureSet& targets, Index candidate) {
    const float* target = targets.columns.col(candidate).data();
    double squared_distance = 0;
    for (Eigen::Index row = 0; row < targets.columns.rows(); ++row) {
      const double difference = static_cast<double>(query_[row]) - static_cast<double>(target[row]);
      squared_distance += difference * difference;
    }
    if (!(squared_distance < squared_distance_)) return;
    squared_distance_ = squared_distance;
    index_ = candidate;
    limit_ = 0.5 * squared_distance - offset_;
  }

  const float* query_;
  double offset_;
  double limit_ = std::numeric_limits<double>::infinity();
  double squared_distance_ = std::numeric_limits<double>::infinity();
  Index index_ = -1;
};

/// For each query the number of the nearest target in the set, the first of equals; -1 if there is none.
///
/// All distances at once, as |t|^2 / 2 - t . q by blocks of a matrix product, show where it is worth to look; what is
/// near enough to win is measured in full.
template <Executor Exec>
[[nodiscard]] std::vector<Index> nearest_features(const FeatureSet& queries, const FeatureSet& targets,
                                                  const Exec& executor) {
  constexpr Index query_block = 64, target_block = 512;
  std::vector<Index> nearest(queries.indices.size(), -1);
  if (targets.size() == 0) return nearest;
  const double largest = static_cast<double>(targets.half_squared_norms.maxCoeff());
  // A sum of n products is off by at most n eps |t| |q| <= n eps (|t|^2 + |q|^2) / 2; twice that, and the norms' own.
  const double rounding =
      static_cast<double>(std::numeric_limits<float>::epsilon()) * static_cast<double>(2 * targets.columns.rows() + 8);
  executor.for_chunks(queries.size(), query_block, [&](Index begin, Index end) {
    std::vector<NearestFeature> found;
    for (Index q = begin; q < end; ++q) {
      const float half_squared_norm = queries.half_squared_norms[q];
      found.emplace_back(queries.columns.col(q).data(), half_squared_norm,
                         rounding * (static_cast<double>(half_squared_norm) + largest));
    }
    Eigen::MatrixXf products(std::min(target_block, targets.size()), end - begin);
    for (Index first = 0; first < targets.size(); first += target_block) {
      const Index size = std::min(target_block, targets.size() - first);
      auto block = products.topRows(size);
      block.noalias() =
          targets.columns.middleCols(first, size).transpose() * queries.columns.middleCols(begin, end - begin);
      for (Index q = 0; q < end - begin; ++q) found[static_cast<std::size_t>(q)].offer(targets, first, block.col(q));
    }
    for (Index q = begin; q < end; ++q)
      nearest[static_cast<std::size_t>(q)] = found[static_cast<std::size_t>(q - begin)].index();
  });
  return nearest;
}

}  // namespace detail

/// Pairs each source feature with the nearest target feature, and keeps the pairs that are nearest both ways.
///
/// Exact: by comparing all with all; of equal distances the lowest index wins.
/// @param source, target  d x n and d x m, one feature a column; columns of zeros or not finite are never matched.
/// @returns pairs in ascending order of the source's index, the same for any executor.
/// @throws std::invalid_argument if the features differ in length.
template <Executor Exec = Serial>
[[nodiscard]] std::vector<FeatureMatch> match_features(const Eigen::Ref<const Eigen::MatrixXf>& source,
                                                       const Eigen::Ref<const Eigen::MatrixXf>& target,
                                                       const MatchOptions& options = {}, const Exec& executor = {}) {
  if (source.rows() != target.rows())
    throw std::invalid_argument("match_features: source and target features differ in length");
  const detail::FeatureSet sources = detail::usable_features(source), targets = detail::usable_features(target);
  const std::vector<Index> forth = detail::nearest_features(sources, targets, executor);
  std::vector<FeatureMatch> matches;
  for (std::size_t k = 0; k < forth.size(); ++k)
    if (forth[k] >= 0) matches.push_back({sources.indices[k], targets.indices[static_cast<std::size_t>(forth[k])]});
  if (!options.mutual || matches.empty()) return matches;

  std::vector<Index> asked;
  for (const FeatureMatch& match : matches) asked.push_back(match.target);
  std::sort(asked.begin(), asked.end());
  asked.erase(std::unique(asked.begin(), asked.end()), asked.end());
  const std::vector<Index> back = detail::nearest_features(detail::usable_features(target, asked), sources, executor);
  std::erase_if(matches, [&](const FeatureMatch& match) {
    const auto answer = std::lower_bound(asked.begin(), asked.end(), match.target) - asked.begin();
    return sources.indices[static_cast<std::size_t>(back[static_cast<std::size_t>(answer)])] != match.source;
  });
  return matches;
}

}  // namespace chainslam
