#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/lanes.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// a . b, both filled up with zeros to whole registers.
[[nodiscard]] inline float padded_product(const float* a, const float* b, std::size_t padded) {
  FloatLanes sum{}, x, y;
  for (std::size_t k = 0; k < padded; k += lane_count) {
    load(a + k, x);
    load(b + k, y);
    sum += x * y;
  }
  float total = 0;
  for (std::size_t lane = 0; lane < lane_count; ++lane) total += sum[lane];
  return total;
}

/// out = a - b, of the same kind.
inline void padded_difference(const float* a, const float* b, std::size_t padded, float* out) {
  FloatLanes x, y;
  for (std::size_t k = 0; k < padded; k += lane_count) {
    load(a + k, x);
    load(b + k, y);
    store(x - y, out + k);
  }
}

/// out += factor * a
inline void add_padded(float factor, const float* a, std::size_t padded, float* out) {
  FloatLanes x, y;
  for (std::size_t k = 0; k < padded; k += lane_count) {
    load(a + k, x);
    load(out + k, y);
    store(y + factor * x, out + k);
  }
}

/// Features one after the other, each filled up with zeros to whole registers.
class FeatureRows {
 public:
  FeatureRows() = default;
  /// Empty, with capacity for that many rows.
  FeatureRows(std::size_t length, std::size_t capacity)
      : length_(length), stride_(whole_lanes(length)), values_(capacity * stride_), columns_(capacity) {}
  /// Of the columns each `step`-th, if it says something.
  FeatureRows(const Eigen::Ref<const Eigen::MatrixXf>& features, Eigen::Index step)
      : FeatureRows(static_cast<std::size_t>(features.rows()),
                    static_cast<std::size_t>((features.cols() + step - 1) / step)) {
    for (Eigen::Index i = 0; i < features.cols(); i += step) {
      float* const row = next();
      std::copy_n(features.data() + i * features.outerStride(), length_, row);
      const float squared_norm = padded_product(row, row, stride_);
      if (is_finite(squared_norm) && squared_norm > 0) columns_[size_++] = static_cast<Index>(i);
    }
  }

  [[nodiscard]] std::size_t size() const { return size_; }
  [[nodiscard]] std::size_t length() const { return length_; }
  [[nodiscard]] std::size_t stride() const { return stride_; }
  [[nodiscard]] const float* operator[](std::size_t k) const { return &values_[k * stride_]; }
  /// The column that it was.
  [[nodiscard]] Index column(std::size_t k) const { return columns_[k]; }

  /// Appends a row of another list; the capacity must not be exceeded.
  void push_back(const FeatureRows& from, std::size_t k) {
    std::copy_n(from[k], stride_, next());
    columns_[size_++] = from.column(k);
  }

 private:
  [[nodiscard]] float* next() { return values_.data() + size_ * stride_; }

  std::size_t length_ = 0, stride_ = 0, size_ = 0;
  std::vector<float> values_;
  std::vector<Index> columns_;
};

/// A sample of a matrix' columns, about so many.
[[nodiscard]] inline FeatureRows sampled(const Eigen::Ref<const Eigen::MatrixXf>& features, Eigen::Index count) {
  return {features, std::max<Eigen::Index>(features.cols() / count, 1)};
}

/// What many of the features look like, as those of flat ground do: of a sample of them the one with the nearest
/// crowd. Taken off all, it leaves distances as they are, but makes the products of the crowd, and what rounding does
/// to them, small: just where many are nearly the same.
[[nodiscard]] [[gnu::cold]] inline std::vector<float> middle(const Eigen::Ref<const Eigen::MatrixXf>& features) {
  constexpr Eigen::Index most = 96;
  constexpr std::size_t crowd = 12;
  const FeatureRows sample = sampled(features, most);
  std::vector<float> center(sample.stride()), difference(sample.stride()), distances(sample.size());
  float least = std::numeric_limits<float>::infinity();
  for (std::size_t i = 0; i < sample.size(); ++i) {
    for (std::size_t j = 0; j < sample.size(); ++j) {
      padded_difference(sample[i], sample[j], sample.stride(), difference.data());
      distances[j] = padded_product(difference.data(), difference.data(), sample.stride());
    }
    float* const place = distances.data() + std::min(crowd, distances.size() - 1);
    std::nth_element(distances.data(), place, distances.data() + distances.size());
    if (!(*place < least)) continue;
    least = *place;
    std::copy_n(sample[i], sample.stride(), center.data());
  }
  return center;
}

/// A unit vector along which the features differ most, about: the power method on a sample's covariance. Features whose
/// shadows on it are far apart are at least as far apart themselves; for that, any unit vector would do.
[[nodiscard]] [[gnu::cold]] inline std::vector<float> spread(const Eigen::Ref<const Eigen::MatrixXf>& features) {
  constexpr Eigen::Index most = 500;
  constexpr int rounds = 20;
  const FeatureRows sample = sampled(features, most);
  const std::size_t length = sample.length(), stride = sample.stride();
  std::vector<float> mean(stride), difference(stride), covariance(length * stride);
  for (std::size_t i = 0; i < sample.size(); ++i)
    add_padded(1 / static_cast<float>(sample.size()), sample[i], stride, mean.data());
  for (std::size_t i = 0; i < sample.size(); ++i) {
    padded_difference(sample[i], mean.data(), stride, difference.data());
    for (std::size_t row = 0; row < length; ++row)
      add_padded(difference[row], difference.data(), stride, &covariance[row * stride]);
  }
  std::vector<float> direction(stride), next(stride);
  std::fill_n(direction.begin(), length, 1 / std::sqrt(static_cast<float>(length)));
  for (int round = 0; round < rounds; ++round) {
    for (std::size_t row = 0; row < length; ++row)
      next[row] = padded_product(&covariance[row * stride], direction.data(), stride);
    const float squared = padded_product(next.data(), next.data(), stride);
    if (!(squared > 0) || !is_finite(squared)) break;
    std::fill(direction.begin(), direction.end(), 0.0F);
    add_padded(1 / std::sqrt(squared), next.data(), stride, direction.data());
  }
  return direction;
}

/// The features that say something, in the order of their shadows on a direction.
class FeatureSet {
 public:
  FeatureSet() = default;
  /// Of the columns those that are finite and not all zeros.
  [[gnu::cold]] FeatureSet(const Eigen::Ref<const Eigen::MatrixXf>& features, const std::vector<float>& center,
                           const std::vector<float>& direction) {
    const FeatureRows usable(features, 1);
    const std::size_t stride = usable.stride(), count = usable.size();
    std::vector<float> difference(stride);
    Table<Ranked> order;
    for (std::size_t k = 0; k < count; ++k) {
      padded_difference(usable[k], center.data(), stride, difference.data());
      const float shadow = padded_product(direction.data(), difference.data(), stride);
      order.push_back({static_cast<double>(shadow), static_cast<Index>(k)});
    }
    sort_ranked(order.all());
    rows_ = FeatureRows(usable.length(), count);
    shadows_ = std::vector<float>(count);
    half_squared_norms_ = std::vector<float>(count);
    for (std::size_t k = 0; k < count; ++k) {
      const Ranked& one = order.all()[k];
      rows_.push_back(usable, static_cast<std::size_t>(one.index));
      shadows_[k] = static_cast<float>(one.rank);
      padded_difference(rows_[k], center.data(), stride, difference.data());
      half_squared_norms_[k] = 0.5F * padded_product(difference.data(), difference.data(), stride);
    }
  }

  [[nodiscard]] Index size() const { return static_cast<Index>(rows_.size()); }
  [[nodiscard]] std::size_t length() const { return rows_.length(); }
  [[nodiscard]] Index index(Index k) const { return rows_.column(static_cast<std::size_t>(k)); }
  /// Feature k, filled up with zeros to `stride` numbers, a multiple of `lane_count`.
  [[nodiscard]] const float* feature(Index k) const { return rows_[static_cast<std::size_t>(k)]; }
  [[nodiscard]] std::size_t stride() const { return rows_.stride(); }
  [[nodiscard]] std::span<const float> half_squared_norms() const { return half_squared_norms_; }
  /// On the direction, from the center; ascending.
  [[nodiscard]] std::span<const float> shadows() const { return shadows_; }
  /// All features minus `center`, `width` side by side: element (row, k) of panel p at (p * rows + row) * width + k.
  /// The last panel is filled up with zeros.
  [[nodiscard]] std::vector<float> panels(std::size_t width, const std::vector<float>& center) const {
    const std::size_t rows = rows_.length();
    std::vector<float> packed((rows_.size() + width - 1) / width * width * rows);
    for (std::size_t k = 0; k < rows_.size(); ++k)
      for (std::size_t row = 0; row < rows; ++row)
        packed[(k / width * rows + row) * width + k % width] = rows_[k][row] - center[row];
    return packed;
  }

 private:
  FeatureRows rows_;
  std::vector<float> half_squared_norms_, shadows_;
};

/// The nearest feature found so far, and the next: numbers in their set, and half their squared distances as products
/// gave them.
struct NearestPair {
  Index best = -1, second = -1;
  float best_half = std::numeric_limits<float>::infinity(), second_half = std::numeric_limits<float>::infinity();
  bool same = false;  ///< the nearest is the very same feature
};

/// The nearest of one set for every feature of another.
///
/// Distances come from products and may be off by a known bound; where that leaves open which of two is nearer, both
/// are measured in full, in double: the answer does not depend on rounding, nor on the order of what is offered: of
/// equal distances the lowest index wins.
class NearestTable {
 public:
  /// So many more limits can be read behind the last query's: nothing is within them.
  static constexpr std::size_t limits_behind = 64;

  /// @param rounding     what a product may be off by, in units of the two half norms.
  /// @param with_second  also find the next nearest (by products alone).
  NearestTable(const FeatureSet& queries, const FeatureSet& others, float rounding, bool with_second)
      : queries_(&queries),
        others_(&others),
        rounding_(rounding),
        with_second_(with_second),
        pairs_(queries.size()),
        limits_(static_cast<std::size_t>(queries.size()) + limits_behind, nothing) {
    std::fill_n(limits_.data(), queries.size(), std::numeric_limits<float>::infinity());
  }

  [[nodiscard]] const NearestPair& operator[](Index query) const { return pairs_[query]; }
  /// What is farther need not be offered.
  [[nodiscard]] const float* limits() const { return limits_.data(); }
  [[nodiscard]] float limit(Index query) const { return limits_[static_cast<std::size_t>(query)]; }

  void offer(Index query, Index other, float half) {
    const auto at = static_cast<std::size_t>(query);
    NearestPair& pair = pairs_[query];
    if (pair.best < 0 || nearer(query, other, half, pair)) {
      const Index last = std::exchange(pair.best, other);
      const float last_half = std::exchange(pair.best_half, half);
      pair.same = half <= slack(query, 0) && rounded_squared_distance(query, other) <= 0;
      if (with_second_) offer_second(pair, last, last_half);
    } else if (with_second_) {
      offer_second(pair, other, half);
    }
    limits_[at] = pair.best_half + slack(query, pair.best_half);
    if (with_second_) limits_[at] = std::max(limits_[at], pair.second_half);
  }

  /// What another table of the same two sets found.
  void offer(const NearestTable& found) {
    for (Index query = 0; query < queries_->size(); ++query) {
      const NearestPair& pair = found[query];
      if (pair.best >= 0 && pair.best_half <= limit(query)) offer(query, pair.best, pair.best_half);
      if (pair.second >= 0 && pair.second_half <= limit(query)) offer(query, pair.second, pair.second_half);
    }
  }

  /// The squared distance in full.
  [[nodiscard]] double squared_distance(Index query, Index other) const {
    const float *a = queries_->feature(query), *b = others_->feature(other);
    double sum = 0;
    for (std::size_t row = 0; row < queries_->stride(); ++row) {
      const double difference = static_cast<double>(a[row]) - static_cast<double>(b[row]);
      sum += difference * difference;
    }
    return sum;
  }

 private:
  static constexpr float nothing = -std::numeric_limits<float>::infinity();

  /// By how much a product may exceed `half` although the distance does not: both are off by `rounding_` times the half
  /// norms |a|^2 / 2 + |b|^2 / 2, and |b|^2 <= 2 |a|^2 + 2 |a - b|^2.
  [[nodiscard]] float slack(Index query, float half) const {
    return 2 * rounding_ * (3 * queries_->half_squared_norms()[static_cast<std::size_t>(query)] + 2 * half);
  }
  [[nodiscard]] bool nearer(Index query, Index other, float half, const NearestPair& pair) const {
    const float unsure_half = slack(query, std::max(half, pair.best_half));
    if (half > pair.best_half + unsure_half) return false;
    if (half + unsure_half < pair.best_half) return true;
    const bool before = others_->index(other) < others_->index(pair.best);
    if (other == pair.best || (pair.same && !before)) return false;
    // Differences squared and summed are off by no more than n eps of the sum itself.
    const float theirs = rounded_squared_distance(query, other), best = rounded_squared_distance(query, pair.best);
    const float unsure = std::numeric_limits<float>::epsilon() * static_cast<float>(queries_->stride() + 4);
    if (theirs > best + unsure * (theirs + best)) return false;
    if (theirs + unsure * (theirs + best) < best) return true;
    const double exactly = squared_distance(query, other), best_exactly = squared_distance(query, pair.best);
    return exactly < best_exactly || (exactly == best_exactly && before);
  }
  [[nodiscard]] float rounded_squared_distance(Index query, Index other) const {
    const float *a = queries_->feature(query), *b = others_->feature(other);
    FloatLanes sum{}, left, right;
    for (std::size_t row = 0; row < queries_->stride(); row += lane_count) {
      load(a + row, left);
      load(b + row, right);
      left -= right;
      sum += left * left;
    }
    float total = 0;
    for (std::size_t lane = 0; lane < lane_count; ++lane) total += sum[lane];
    return total;
  }
  static void offer_second(NearestPair& pair, Index other, float half) {
    if (other < 0 || other == pair.best) return;
    if (half < pair.second_half || (half == pair.second_half && other < pair.second)) {
      pair.second = other;
      pair.second_half = half;
    }
  }

  const FeatureSet* queries_;
  const FeatureSet* others_;
  float rounding_;
  bool with_second_;
  Table<NearestPair> pairs_;
  std::vector<float> limits_;
};

}  // namespace chainslam::detail
