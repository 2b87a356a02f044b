#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <numbers>
#include <span>
#include <stdexcept>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/lanes.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se2.hpp"
#include "chainslam/registration/matched_points.hpp"

namespace chainslam {

/// A set of small numbers, a bit each.
class BitSet {
 public:
  using Word = std::uint64_t;  ///< 64 bits

  BitSet() = default;
  explicit BitSet(Index size) : words_(word_count(size)) {}  ///< an empty set of numbers below `size`
  explicit BitSet(std::span<const Word> words) : words_(words.begin(), words.end()) {}  ///< a copy of a row's bits

  /// Words for so many bits.
  [[nodiscard]] static std::size_t word_count(Index size) { return (static_cast<std::size_t>(size) + 63) / 64; }
  [[nodiscard]] std::span<const Word> words() const { return words_; }  ///< all bits
  /// Whether i is in it.
  [[nodiscard]] bool contains(Index i) const {
    return (words_[static_cast<std::size_t>(i) / 64] >> (i % 64) & 1U) != 0;
  }
  void insert(Index i) { words_[static_cast<std::size_t>(i) / 64] |= Word{1} << (i % 64); }    ///< puts i into it
  void erase(Index i) { words_[static_cast<std::size_t>(i) / 64] &= ~(Word{1} << (i % 64)); }  ///< takes i out of it
  /// Keeps what is in `other`, too.
  void intersect(std::span<const Word> other) {
    for (std::size_t w = 0; w < words_.size(); ++w) words_[w] &= other[w];
  }
  /// Elements below `from` are left or not.
  void subtract(std::span<const Word> other, Index from = 0) {
    for (std::size_t w = static_cast<std::size_t>(from) / 64; w < words_.size(); ++w) words_[w] &= ~other[w];
  }
  /// How many numbers are in it.
  [[nodiscard]] Index count() const {
    Index total = 0;
    for (const Word word : words_) total += std::popcount(word);
    return total;
  }
  /// How many of them are in `other`, too.
  [[nodiscard]] Index count_common(std::span<const Word> other) const {
    Index total = 0;
    for (std::size_t w = 0; w < words_.size(); ++w) total += std::popcount(words_[w] & other[w]);
    return total;
  }
  /// The smallest element, or -1, where none is below `from`.
  [[nodiscard]] Index first(Index from = 0) const {
    for (std::size_t w = static_cast<std::size_t>(from) / 64; w < words_.size(); ++w)
      if (words_[w] != 0) return static_cast<Index>(64 * w) + std::countr_zero(words_[w]);
    return -1;
  }
  /// Calls `visit(i)` for every element, ascending.
  template <class Visit>
  void for_each(Visit&& visit) const {
    for (std::size_t w = 0; w < words_.size(); ++w)
      for (Word word = words_[w]; word != 0; word &= word - 1)
        visit(static_cast<Index>(64 * w) + std::countr_zero(word));
  }

 private:
  std::vector<Word> words_;
};

/// An undirected graph without loops, a row of bits for each vertex: for thousands of vertices and many edges.
class BitGraph {
 public:
  BitGraph() = default;
  /// A graph of so many vertices without edges.
  explicit BitGraph(Index size)
      : size_(size), width_(BitSet::word_count(size)), words_(width_ * static_cast<std::size_t>(size)) {}

  [[nodiscard]] Index size() const { return size_; }  ///< number of vertices
  /// The neighbours of vertex i.
  [[nodiscard]] std::span<const BitSet::Word> row(Index i) const {
    return std::span(words_).subspan(static_cast<std::size_t>(i) * width_, width_);
  }
  /// The neighbours of vertex i.
  [[nodiscard]] std::span<BitSet::Word> row(Index i) {
    return std::span(words_).subspan(static_cast<std::size_t>(i) * width_, width_);
  }
  /// Whether there is an edge between i and j.
  [[nodiscard]] bool connected(Index i, Index j) const {
    return (row(i)[static_cast<std::size_t>(j) / 64] >> (j % 64) & 1U) != 0;
  }
  /// Adds an edge between i and j.
  void connect(Index i, Index j) {
    row(i)[static_cast<std::size_t>(j) / 64] |= BitSet::Word{1} << (j % 64);
    row(j)[static_cast<std::size_t>(i) / 64] |= BitSet::Word{1} << (i % 64);
  }
  /// Number of neighbours of vertex i.
  [[nodiscard]] Index degree(Index i) const {
    Index total = 0;
    for (const BitSet::Word word : row(i)) total += std::popcount(word);
    return total;
  }
  /// The graph among some vertices, ascending, which are renumbered.
  [[nodiscard]] BitGraph among(std::span<const Index> vertices) const {
    BitGraph part(to_index(vertices.size()));
    for (Index i = 0; i < part.size(); ++i)
      for (Index j = 0; j < i; ++j)
        if (connected(vertices[static_cast<std::size_t>(i)], vertices[static_cast<std::size_t>(j)])) part.connect(i, j);
    return part;
  }

 private:
  Index size_ = 0;
  std::size_t width_ = 0;
  std::vector<BitSet::Word> words_;
};

/// When two matches can be right together: a rigid motion changes neither the distance of two points nor the angle of
/// their normals.
struct ConsistencyOptions {
  double max_stretch = 0.5;      ///< metres, by which the distances may differ
  double least_distance = 1.0;   ///< metres; nearer ones say little of the rotation and are not connected
  double max_cosine_gap = 0.35;  ///< by which the normals' scalar products may differ, where there are normals
};

namespace detail {

/// Columns of floats for `connect_consistent`, about the middle of the points, filled up to whole registers.
class ConsistencyColumns {
 public:
  explicit ConsistencyColumns(const MatchedPoints& points) : padded_(whole_lanes(points.source.size())) {
    add(points.source, true);
    add(points.target, true);
    if (!points.has_normals()) return;
    add(points.source_normals, false);
    add(points.target_normals, false);
  }
  [[nodiscard]] std::size_t padded() const { return padded_; }
  [[nodiscard]] bool has_normals() const { return columns_.size() > 2; }
  /// The squared distance of points i and those from j on, at either end; or the scalar product of the normals.
  void squared_distances(std::size_t end, std::size_t i, std::size_t j, FloatLanes& result) const {
    FloatLanes sum{};
    for (const std::vector<float>& column : columns_[end]) {
      FloatLanes values;
      load(&column[j], values);
      values -= column[i];
      sum += values * values;
    }
    result = sum;
  }
  void normal_products(std::size_t end, std::size_t i, std::size_t j, FloatLanes& result) const {
    FloatLanes sum{};
    for (const std::vector<float>& column : columns_[2 + end]) {
      FloatLanes values;
      load(&column[j], values);
      sum += values * column[i];
    }
    result = sum;
  }

 private:
  void add(const std::vector<Eigen::Vector3d>& vectors, bool centered) {
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (const Eigen::Vector3d& v : vectors) mean += v;
    if (!vectors.empty()) mean /= static_cast<double>(vectors.size());
    std::array<std::vector<float>, 3>& columns = columns_.emplace_back();
    for (std::size_t axis = 0; axis < 3; ++axis) {
      columns[axis].resize(padded_);
      for (std::size_t i = 0; i < vectors.size(); ++i) {
        const auto row = static_cast<Eigen::Index>(axis);
        columns[axis][i] = static_cast<float>(vectors[i][row] - (centered ? mean[row] : 0.0));
      }
    }
  }

  std::size_t padded_;
  std::vector<std::array<std::vector<float>, 3>> columns_;
};

/// Writes the bits of a mask of lanes, which start at vertex j, into a row.
inline void set_bits(const MaskLanes& mask, std::size_t j, std::span<BitSet::Word> row) {
  BitSet::Word bits = 0;
  for (std::size_t lane = 0; lane < lane_count; ++lane) bits |= static_cast<BitSet::Word>(mask[lane] & 1) << lane;
  row[j / 64] |= bits << (j % 64);
}

}  // namespace detail

/// The graph of matches that can be right together (Bailey et al. 2000; Shi et al. 2021, ROBIN): right matches are all
/// connected with each other, wrong ones rarely with many.
///
/// Distances a and b differ by at most s if (a^2 + b^2 - s^2)^2 <= 4 a^2 b^2, or the left root is negative: no root is
/// taken. All pairs are looked at, several at once.
/// @returns one vertex a match; the same to the bit for any executor.
/// @throws std::invalid_argument if an option makes no sense.
template <Executor Exec = Serial>
[[nodiscard]] BitGraph consistency_graph(const MatchedPoints& points, const ConsistencyOptions& options = {},
                                         const Exec& executor = {}) {
  using detail::FloatLanes, detail::lane_count, detail::MaskLanes;
  if (!(options.max_stretch > 0) || !(options.least_distance >= 0) || !(options.max_cosine_gap >= 0))
    throw std::invalid_argument("consistency_graph: max_stretch must be positive, the others not negative");
  constexpr Index grain = 64;
  const detail::ConsistencyColumns columns(points);
  const auto squared_stretch = static_cast<float>(options.max_stretch * options.max_stretch);
  const auto least = static_cast<float>(options.least_distance * options.least_distance);
  const auto gap = static_cast<float>(options.max_cosine_gap);
  BitGraph graph(points.size());
  executor.for_chunks(points.size(), grain, [&](Index begin, Index end) {
    for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i) {
      const std::span<BitSet::Word> row = graph.row(static_cast<Index>(i));
      for (std::size_t j = 0; j < columns.padded(); j += lane_count) {
        FloatLanes a, b;
        columns.squared_distances(0, i, j, a);
        columns.squared_distances(1, i, j, b);
        const FloatLanes rest = a + b - squared_stretch;
        MaskLanes consistent = ((rest * rest <= 4.0F * a * b) | (rest < 0.0F)) & (a >= least) & (b >= least);
        if (columns.has_normals()) {
          FloatLanes p, q;
          columns.normal_products(0, i, j, p);
          columns.normal_products(1, i, j, q);
          const FloatLanes difference = p - q;
          consistent &= (difference <= gap) & (difference >= -gap);
        }
        detail::set_bits(consistent, j, row);
      }
      if (const auto behind = static_cast<Index>(points.source.size()) % 64; behind != 0)
        row.back() &= (BitSet::Word{1} << behind) - 1;
      row[i / 64] &= ~(BitSet::Word{1} << (i % 64));
    }
  });
  return graph;
}

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
