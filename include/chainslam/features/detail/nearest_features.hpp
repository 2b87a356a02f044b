#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstddef>
#include <limits>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/finite.hpp"
#include "chainslam/core/lanes.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// Whether a feature says something: finite and not all zeros.
[[nodiscard]] inline bool is_usable(float squared_norm) { return is_finite(squared_norm) && squared_norm > 0; }

/// What many of the features look like, as those of flat ground do: of a sample of them the one with the nearest
/// crowd. Taken off all, it leaves distances as they are, but makes the products of the crowd, and what rounding does
/// to them, small: just where many are nearly the same.
[[nodiscard]] inline Eigen::VectorXf middle(const Eigen::Ref<const Eigen::MatrixXf>& features) {
  constexpr Eigen::Index most = 96, crowd = 12;
  const Eigen::Index step = std::max<Eigen::Index>(features.cols() / most, 1);
  std::vector<Eigen::Index> sample;
  for (Eigen::Index i = 0; i < features.cols(); i += step)
    if (is_usable(features.col(i).squaredNorm())) sample.push_back(i);
  Eigen::VectorXf center = Eigen::VectorXf::Zero(features.rows());
  float least = std::numeric_limits<float>::infinity();
  std::vector<float> distances(sample.size());
  for (const Eigen::Index i : sample) {
    std::transform(sample.begin(), sample.end(), distances.begin(),
                   [&](Eigen::Index j) { return (features.col(i) - features.col(j)).squaredNorm(); });
    const auto place = distances.begin() + std::min<std::ptrdiff_t>(crowd, std::ssize(distances) - 1);
    std::nth_element(distances.begin(), place, distances.end());
    if (!(*place < least)) continue;
    least = *place;
    center = features.col(i);
  }
  return center;
}

/// The features that say something, packed for products: panels of `Width` features, row after row.
class FeatureSet {
 public:
  /// Of the columns those that are finite and not all zeros, minus `center`.
  FeatureSet(const Eigen::Ref<const Eigen::MatrixXf>& features, const Eigen::VectorXf& center) {
    for (Eigen::Index i = 0; i < features.cols(); ++i)
      if (is_usable(features.col(i).squaredNorm())) indices_.push_back(static_cast<Index>(i));
    stride_ = whole_lanes(static_cast<std::size_t>(features.rows()));
    values_.resize(indices_.size() * stride_);
    for (std::size_t k = 0; k < indices_.size(); ++k)
      std::copy_n(features.col(indices_[k]).data(), features.rows(), &values_[k * stride_]);
    half_squared_norms_.reserve(indices_.size());
    for (const Index i : indices_) half_squared_norms_.push_back(0.5F * (features.col(i) - center).squaredNorm());
  }

  [[nodiscard]] Index size() const { return static_cast<Index>(indices_.size()); }
  [[nodiscard]] Index index(Index k) const { return indices_[static_cast<std::size_t>(k)]; }
  /// Feature k, filled up with zeros to `stride` numbers, a multiple of `lane_count`.
  [[nodiscard]] const float* feature(Index k) const { return &values_[static_cast<std::size_t>(k) * stride_]; }
  [[nodiscard]] std::size_t stride() const { return stride_; }
  [[nodiscard]] std::span<const float> half_squared_norms() const { return half_squared_norms_; }
  /// All features minus `center`, `width` side by side: element (row, k) of panel p at (p * rows + row) * width + k.
  /// The last panel is filled up with zeros.
  [[nodiscard]] std::vector<float> panels(std::size_t width, const Eigen::VectorXf& center) const {
    const auto rows = static_cast<std::size_t>(center.rows());
    std::vector<float> packed((indices_.size() + width - 1) / width * width * rows);
    for (std::size_t k = 0; k < indices_.size(); ++k)
      for (std::size_t row = 0; row < rows; ++row)
        packed[(k / width * rows + row) * width + k % width] =
            values_[k * stride_ + row] - center[static_cast<Eigen::Index>(row)];
    return packed;
  }

 private:
  std::size_t stride_ = 0;
  std::vector<float> values_;
  std::vector<Index> indices_;
  std::vector<float> half_squared_norms_;
};

/// The nearest feature found so far, and the next: numbers in their set, and half their squared distances as products
/// gave them.
struct NearestPair {
  Index best = -1, second = -1;
  float best_half = std::numeric_limits<float>::infinity(), second_half = std::numeric_limits<float>::infinity();
};

/// The nearest of one set for every feature of another.
///
/// Distances come from products and may be off by a known bound; where that leaves open which of two is nearer, both
/// are measured in full, in double: the answer does not depend on rounding. Of equal distances the one offered first
/// wins.
class NearestTable {
 public:
  /// So many more limits can be read behind the last query's: nothing is within them.
  static constexpr std::size_t limits_behind = 64;

  /// @param rounding     what a product may be off by, in units of the two half norms.
  /// @param with_second  also find the next nearest (by products alone).
  NearestTable(const FeatureSet& queries, const FeatureSet& others, float rounding, bool with_second)
      : queries_(&queries), others_(&others), rounding_(rounding), with_second_(with_second) {
    pairs_.resize(static_cast<std::size_t>(queries.size()));
    limits_.assign(pairs_.size(), std::numeric_limits<float>::infinity());
    limits_.resize(pairs_.size() + limits_behind, nothing);
  }

  [[nodiscard]] const NearestPair& operator[](Index query) const { return pairs_[static_cast<std::size_t>(query)]; }
  /// What is farther need not be offered.
  [[nodiscard]] const float* limits() const { return limits_.data(); }
  [[nodiscard]] float limit(Index query) const { return limits_[static_cast<std::size_t>(query)]; }

  void offer(Index query, Index other, float half) {
    const auto at = static_cast<std::size_t>(query);
    NearestPair& pair = pairs_[at];
    if (pair.best < 0 || nearer(query, other, half, pair)) {
      const Index last = std::exchange(pair.best, other);
      const float last_half = std::exchange(pair.best_half, half);
      if (with_second_) offer_second(pair, last, last_half);
    } else if (with_second_) {
      offer_second(pair, other, half);
    }
    limits_[at] = same(query, pair) ? nothing : pair.best_half + slack(query, pair.best_half);
    if (with_second_) limits_[at] = std::max(limits_[at], pair.second_half);
  }

  /// What another table of the same two sets found, after this one.
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

  /// Whether the nearest is the same feature: nothing that comes later can be nearer. Flat ground has many of them.
  [[nodiscard]] bool same(Index query, const NearestPair& pair) const {
    return pair.best_half <= slack(query, 0) && rounded_squared_distance(query, pair.best) == 0;
  }
  /// By how much a product may exceed `half` although the distance does not: both are off by `rounding_` times the half
  /// norms |a|^2 / 2 + |b|^2 / 2, and |b|^2 <= 2 |a|^2 + 2 |a - b|^2.
  [[nodiscard]] float slack(Index query, float half) const {
    return 2 * rounding_ * (3 * queries_->half_squared_norms()[static_cast<std::size_t>(query)] + 2 * half);
  }
  [[nodiscard]] bool nearer(Index query, Index other, float half, const NearestPair& pair) const {
    const float unsure_half = slack(query, std::max(half, pair.best_half));
    if (half > pair.best_half + unsure_half) return false;
    if (half + unsure_half < pair.best_half) return true;
    if (other == pair.best) return false;
    // Differences squared and summed are off by no more than n eps of the sum itself.
    const float theirs = rounded_squared_distance(query, other), best = rounded_squared_distance(query, pair.best);
    const float unsure = std::numeric_limits<float>::epsilon() * static_cast<float>(queries_->stride() + 4);
    if (theirs > best + unsure * (theirs + best)) return false;
    if (theirs + unsure * (theirs + best) < best) return true;
    return squared_distance(query, other) < squared_distance(query, pair.best);
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
  std::vector<NearestPair> pairs_;
  std::vector<float> limits_;
};

/// All distances between two sets of features, a tile at a time, offered to the tables of both.
class DistanceTiles {
 public:
  static constexpr std::size_t tile_rows = 6, tile_columns = 2 * lane_count;

  DistanceTiles(const FeatureSet& rows, const FeatureSet& columns, const Eigen::VectorXf& center)
      : rows_(rows.panels(tile_rows, center)),
        columns_(columns.panels(tile_columns, center)),
        length_(static_cast<std::size_t>(center.rows())),
        row_count_(static_cast<std::size_t>(rows.size())),
        column_count_(static_cast<std::size_t>(columns.size())),
        row_norms_(padded(rows.half_squared_norms(), tile_rows)),
        column_norms_(padded(columns.half_squared_norms(), tile_columns)) {}

  [[nodiscard]] Index row_panels() const { return static_cast<Index>(row_norms_.size() / tile_rows); }

  /// Compares the features of row panels [begin, end) with all others.
  void offer(Index begin, Index end, NearestTable& of_rows, NearestTable& of_columns) const {
    for (std::size_t panel = 0; panel * tile_columns < column_count_; ++panel)
      for (auto row = static_cast<std::size_t>(begin); row < static_cast<std::size_t>(end); ++row)
        offer_tile(row, panel, of_rows, of_columns);
  }

 private:
  using Tile = std::array<std::array<FloatLanes, 2>, tile_rows>;

  /// Infinitely long where a panel has no more features: nothing is ever near.
  [[nodiscard]] static std::vector<float> padded(std::span<const float> norms, std::size_t width) {
    std::vector<float> result(norms.begin(), norms.end());
    result.resize((norms.size() + width - 1) / width * width, std::numeric_limits<float>::infinity());
    return result;
  }

  /// |a|^2 / 2 + |b|^2 / 2 - a . b, half the squared distance, of every pair.
  void measure(std::size_t row_panel, std::size_t column_panel, Tile& result) const {
    FloatLanes left, right;
    load(&column_norms_[column_panel * tile_columns], left);
    load(&column_norms_[column_panel * tile_columns + lane_count], right);
    Tile tile;
    const float* norms = &row_norms_[row_panel * tile_rows];
#pragma GCC unroll 6
    for (std::size_t r = 0; r < tile_rows; ++r) tile[r] = {norms[r] + left, norms[r] + right};
    const float* a = &rows_[row_panel * tile_rows * length_];
    const float* b = &columns_[column_panel * tile_columns * length_];
    for (std::size_t k = 0; k < length_; ++k, a += tile_rows, b += tile_columns) {
      load(b, left);
      load(b + lane_count, right);
#pragma GCC unroll 6
      for (std::size_t r = 0; r < tile_rows; ++r) {
        tile[r][0] -= a[r] * left;
        tile[r][1] -= a[r] * right;
      }
    }
    result = tile;
  }

  /// Where a row's distances are within a limit, its own or the columns'.
  static void find_near(const std::array<FloatLanes, 2>& row, float limit, const FloatLanes& left,
                        const FloatLanes& right, MaskLanes& near) {
    near |= (row[0] <= left) | (row[1] <= right) | (row[0] <= limit) | (row[1] <= limit);
  }

  void offer_tile(std::size_t row_panel, std::size_t column_panel, NearestTable& of_rows,
                  NearestTable& of_columns) const {
    Tile tile;
    measure(row_panel, column_panel, tile);
    const std::size_t first_row = row_panel * tile_rows, first_column = column_panel * tile_columns;
    const float* row_limits = of_rows.limits() + first_row;
    FloatLanes left, right;
    load(of_columns.limits() + first_column, left);
    load(of_columns.limits() + first_column + lane_count, right);
    MaskLanes near{};
#pragma GCC unroll 6
    for (std::size_t r = 0; r < tile_rows; ++r) find_near(tile[r], row_limits[r], left, right, near);
    if (!any(near)) return;
    const std::size_t rows = std::min(tile_rows, row_count_ - first_row);
    const std::size_t columns = std::min(tile_columns, column_count_ - first_column);
    for (std::size_t r = 0; r < rows; ++r) {
      near = MaskLanes{};
      find_near(tile[r], row_limits[r], left, right, near);
      if (!any(near)) continue;
      for (std::size_t c = 0; c < columns; ++c) {
        const auto row = static_cast<Index>(first_row + r), column = static_cast<Index>(first_column + c);
        const float half = tile[r][c / lane_count][c % lane_count];
        if (half <= of_rows.limit(row)) of_rows.offer(row, column, half);
        if (half <= of_columns.limit(column)) of_columns.offer(column, row, half);
      }
    }
  }

  std::vector<float> rows_, columns_;
  std::size_t length_, row_count_, column_count_;
  std::vector<float> row_norms_, column_norms_;
};

/// The nearest both ways.
struct NearestBothWays {
  NearestTable of_source, of_target;
};

/// From one pass over all distances: of the features of both sets, the nearest of the other.
template <Executor Exec>
[[nodiscard]] NearestBothWays nearest_both_ways(const FeatureSet& source, const FeatureSet& target,
                                                const Eigen::VectorXf& center, bool with_second, const Exec& executor) {
  // A sum of n products is off by at most n eps |a| |b| <= n eps (|a|^2 + |b|^2) / 2; twice that, and the norms' own.
  const float rounding = std::numeric_limits<float>::epsilon() * static_cast<float>(2 * center.rows() + 16);
  NearestBothWays found{NearestTable(source, target, rounding, with_second),
                        NearestTable(target, source, rounding, with_second)};
  if (source.size() == 0 || target.size() == 0) return found;
  const DistanceTiles tiles(source, target, center);
  // What the first panels found spares the others, which do not know of each other, most of their offers.
  const Index panels = tiles.row_panels();
  const Index ahead = std::min(std::max(Index{40}, panels / 16), panels), rest = panels - ahead;
  const Index grain = std::max(Index{96}, (rest + 5) / 6);
  tiles.offer(0, ahead, found.of_source, found.of_target);
  std::vector<NearestTable> parts(static_cast<std::size_t>(count_chunks(rest, grain)), found.of_target);
  executor.for_chunks(rest, grain, [&](Index begin, Index end) {
    tiles.offer(ahead + begin, ahead + end, found.of_source, parts[static_cast<std::size_t>(begin / grain)]);
  });
  for (const NearestTable& part : parts) found.of_target.offer(part);
  return found;
}

}  // namespace chainslam::detail
