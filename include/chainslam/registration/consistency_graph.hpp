#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <stdexcept>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/lanes.hpp"
#include "chainslam/core/types.hpp"
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

}  // namespace chainslam
