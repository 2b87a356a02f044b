#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <span>
#include <type_traits>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/detail/nearest_list.hpp"
#include "chainslam/search/detail/point_lanes.hpp"
#include "chainslam/search/detail/point_source.hpp"
#include "chainslam/search/detail/tree_leaves.hpp"

namespace chainslam {

/// The k nearest of each of a `KdTree`'s own points, a leaf at a time: its points ask together, twice as fast as one
/// by one. What lies within reach of the leaf is gathered once, and from that each point takes its k nearest, in no
/// order but always the same.
///
/// How far a leaf reaches is guessed from the leaf before. Points that find fewer than k within that distance ask again
/// with a longer one, and in the end, or where too much lies within reach, the tree, so that the answers are exact
/// whatever the guess. Use one object for leaves that follow one another, and one a thread.
template <class Tree>
class LeafNeighbors {
 public:
  using Scalar = typename Tree::Scalar;  ///< number type
  using Vector = typename Tree::Vector;  ///< a point

  /// @param tree          of three dimensions; must outlive this.
  /// @param k             0: all within `max_distance`.
  /// @param max_distance  metres, > 0.
  LeafNeighbors(const Tree& tree, std::size_t k, Scalar max_distance)
      : tree_(&tree),
        leaves_(tree),
        k_(k == 0 ? std::numeric_limits<std::size_t>::max() : k),
        max_distance_(max_distance),
        limit_(detail::distance_bound(max_distance)) {}

  /// Leaves of the tree, each with 1 to 32 points.
  [[nodiscard]] Index leaves() const { return leaves_.count(); }

  /// Whether the tree holds the points of the cloud that are finite, and no others.
  template <Cloud Points>
  [[nodiscard]] bool holds(const Points& cloud) const {
    if (tree_->size() + static_cast<std::size_t>(tree_->rejected()) != cloud_size(cloud)) return false;
    for (std::size_t i = 0; tree_->rejected() > 0 && i < cloud_size(cloud); ++i)
      if (!tree_->contains(static_cast<Index>(i)) && is_finite(position(cloud, i))) return false;
    for (Index leaf = 0; leaf < leaves_.count(); ++leaf) {
      const std::span<const Index> indices = leaves_.indices(leaf);
      for (std::size_t lane = 0; lane < indices.size(); ++lane)
        if (!leaves_.points(leaf).holds(static_cast<int>(lane),
                                        detail::source_position<Scalar, 3>(cloud, indices[lane])))
          return false;
    }
    return true;
  }

  /// Calls `visit(index, count, offset)` for each point of the leaf: it has `count` neighbours, itself among them, the
  /// i-th at `offset(i, axis)` from it.
  template <class Visit>
  void search(Index leaf, Visit&& visit) {
    const auto& points = leaves_.points(leaf);
    const std::span<const Index> indices = leaves_.indices(leaf);
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const auto used = std::span(points.columns[axis]).first(indices.size());
      low_[axis] = *std::min_element(used.begin(), used.end());
      high_[axis] = *std::max_element(used.begin(), used.end());
    }
    if (reach_ == 0) guess_ = reach_ = first_reach(indices.size());
    Scalar farthest = 0;
    auto waiting = static_cast<std::uint32_t>((std::uint64_t{1} << indices.size()) - 1);
    Scalar reach = takes_all() ? limit_ : std::min(reach_, limit_);
    for (int attempt = 0; waiting != 0; ++attempt, reach = std::min(4 * reach, limit_)) {
      const bool gathered = attempt < most_attempts && gather(reach);
      if (gathered && gathered_ == tree_->size()) reach = limit_;
      std::uint32_t failed = 0;
      for (; waiting != 0; waiting &= waiting - 1) {
        const int lane = std::countr_zero(waiting);
        const Vector p = points.position(lane);
        if (!gathered) {
          ask_tree(p);
        } else if (!select(p, reach)) {
          failed |= std::uint32_t{1} << lane;
          continue;
        }
        farthest = std::max(farthest, farthest_);
        visit(indices[static_cast<std::size_t>(lane)], chosen_count_, [&](std::size_t i, std::size_t axis) {
          return block_[axis][chosen_.data()[i]] - p[static_cast<Eigen::Index>(axis)];
        });
      }
      waiting = failed;
    }
    if (farthest > 0) reach_ = farthest * leaf_margin;
  }

 private:
  static constexpr std::size_t width = 32;
  static constexpr std::size_t most_leaves = 128;  ///< to be gathered
  static constexpr int most_attempts = 3;
  /// From one leaf's farthest neighbour to the reach of the next leaf, and from point to point; squared.
  static constexpr Scalar leaf_margin{1.125}, point_margin{1.5};

  [[nodiscard]] bool takes_all() const { return k_ == std::numeric_limits<std::size_t>::max(); }

  /// Squared: a square of the leaf's size, scaled to k points.
  [[nodiscard]] Scalar first_reach(std::size_t used) const {
    Scalar side = 0;
    for (std::size_t axis = 0; axis < 3; ++axis) side = std::max(side, high_[axis] - low_[axis]);
    const auto wanted = static_cast<Scalar>(std::min(k_, tree_->size()));
    return std::max(side * side * wanted / static_cast<Scalar>(used), std::numeric_limits<Scalar>::min());
  }

  /// Brings together the points nearer to the leaf's box than `reach`, a squared distance. False if they are too many.
  [[nodiscard]] bool gather(Scalar reach) {
    // Distances to the box and to a point in it may round otherwise.
    const Scalar wide = reach * (1 + 8 * std::numeric_limits<Scalar>::epsilon());
    leaves_.near_box(low_, high_, wide, takes_all() ? std::numeric_limits<std::size_t>::max() : most_leaves, near_);
    if (!takes_all() && near_.size() > most_leaves) return false;
    make_room(near_.size() * width + width);
    gathered_ = 0;
    for (const Index leaf : near_) {
      const auto& points = leaves_.points(leaf);
      alignas(64) std::array<Scalar, width> distances{};
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const Scalar low = low_[axis], high = high_[axis];
        for (std::size_t i = 0; i < width; ++i) {
          const Scalar p = points.columns[axis][i];
          const Scalar under = low - p, over = p - high;
          Scalar outside = under > over ? under : over;
          outside = outside > 0 ? outside : Scalar(0);
          distances[i] += outside * outside;
        }
      }
      for (std::uint32_t mask = detail::lanes_below(distances, wide); mask != 0; mask &= mask - 1) {
        const auto lane = static_cast<std::size_t>(std::countr_zero(mask));
        for (std::size_t axis = 0; axis < 3; ++axis) block_[axis][gathered_] = points.columns[axis][lane];
        ++gathered_;
      }
    }
    for (auto& column : block_)
      std::fill_n(column.begin() + static_cast<std::ptrdiff_t>(gathered_), width,
                  std::numeric_limits<Scalar>::infinity());
    return true;
  }

  void make_room(std::size_t count) {
    if (squared_.size() >= count) return;
    for (auto& column : block_) column.resize(count);
    squared_.resize(count);
    chosen_.resize(static_cast<Offset>(count));
    candidates_.resize(count);
  }

  /// Chooses by the tree's own search.
  void ask_tree(const Vector& p) {
    found_.resize(std::min(k_, tree_->size()));
    found_.resize(static_cast<std::size_t>(tree_->knn(p, found_, max_distance_)));
    make_room(found_.size());
    chosen_count_ = found_.size();
    for (std::size_t i = 0; i < found_.size(); ++i) {
      const Vector neighbor = tree_->position(found_[i].index);
      for (std::size_t axis = 0; axis < 3; ++axis) block_[axis][i] = neighbor[static_cast<Eigen::Index>(axis)];
      chosen_.data()[i] = static_cast<std::uint32_t>(i);
    }
    farthest_ = found_.empty() ? Scalar(0) : found_.back().squared_distance;
  }

  /// Chooses, of what is gathered and nearer to p than `reach`, the k nearest. False if there are fewer and more can be
  /// found farther away.
  [[nodiscard]] bool select(const Vector& p, Scalar reach) {
    const std::size_t padded = (gathered_ + width - 1) / width * width;
    const Scalar x = p[0], y = p[1], z = p[2];
    for (std::size_t i = 0; i < padded; ++i) {
      const Scalar dx = block_[0][i] - x, dy = block_[1][i] - y, dz = block_[2][i] - z;
      squared_[i] = dx * dx + dy * dy + dz * dz;
    }
    // A bound below which there are k, and not many more.
    Scalar bound = std::min(guess_, reach), least = 0, most = reach;
    std::size_t count = takes_all() ? list_nearer(reach, padded) : count_nearer(bound, padded);
    for (int step = 0; step < 12 && !takes_all() && (count < k_ || count > k_ + spare); ++step) {
      if (count < k_) {
        if (bound == reach) break;
        least = bound;
        bound = most < reach ? (least + most) / 2 : std::min(2 * bound, reach);
      } else {
        most = bound;
        bound = least > 0 ? (least + most) / 2 : most / 2;
      }
      count = count_nearer(bound, padded);
    }
    if (count < k_ && bound < reach) count = count_nearer(bound = most, padded);
    if (count < k_ && reach < limit_) return false;
    if (!takes_all()) (void)list_nearer(bound, padded);
    farthest_ = keep_nearest();
    guess_ = std::max(farthest_ * point_margin, std::numeric_limits<Scalar>::min());
    return true;
  }

  [[nodiscard]] std::size_t count_nearer(Scalar bound, std::size_t padded) const {
    using Count = std::conditional_t<sizeof(Scalar) == 4, std::int32_t, std::int64_t>;
    Count count = 0;
    for (std::size_t i = 0; i < padded; ++i) count += squared_[i] < bound ? 1 : 0;
    return static_cast<std::size_t>(count);
  }

  std::size_t list_nearer(Scalar bound, std::size_t padded) {
    chosen_count_ = 0;
    for (std::size_t begin = 0; begin < padded; begin += width) {
      alignas(64) std::array<Scalar, width> distances;
      std::memcpy(distances.data(), squared_.data() + begin, sizeof(distances));
      for (std::uint32_t mask = detail::lanes_below(distances, bound); mask != 0; mask &= mask - 1) {
        const auto lane = static_cast<std::size_t>(std::countr_zero(mask));
        chosen_.data()[chosen_count_] = static_cast<std::uint32_t>(begin + lane);
        candidates_[chosen_count_++] = distances[lane];
      }
    }
    return chosen_count_;
  }

  /// Leaves the k nearest of those chosen, in their order; of those as far as the k-th, the first. Returns how far that
  /// is.
  Scalar keep_nearest() {
    const std::size_t count = chosen_count_;
    if (count <= k_) return *std::max_element(candidates_.begin(), candidates_.begin() + to_difference(count));
    const Scalar last = count <= width ? kth_of_few(count) : kth_of_many(count);
    std::size_t nearer = 0;
    for (std::size_t i = 0; i < count; ++i) nearer += candidates_[i] < last ? 1U : 0U;
    std::size_t as_far = k_ - nearer, kept = 0;
    for (std::size_t i = 0; i < count; ++i) {
      const std::size_t tie = static_cast<std::size_t>(candidates_[i] == last) & static_cast<std::size_t>(as_far > 0);
      chosen_.data()[kept] = chosen_.data()[i];
      kept += static_cast<std::size_t>(candidates_[i] < last) | tie;
      as_far -= tie;
    }
    chosen_count_ = k_;
    return last;
  }

  /// The k-th smallest squared distance: the least that is not below k of them. No branch depends on the distances.
  [[nodiscard]] Scalar kth_of_few(std::size_t count) const {
    constexpr Scalar far = std::numeric_limits<Scalar>::infinity();
    using Count = std::conditional_t<sizeof(Scalar) == 4, std::int32_t, std::int64_t>;
    alignas(64) std::array<Scalar, width> distances;
    alignas(64) std::array<Count, width> not_above{};
    for (std::size_t i = 0; i < width; ++i) distances[i] = i < count ? candidates_[i] : far;
    for (std::size_t j = 0; j < count; ++j) {
      const Scalar distance = candidates_[j];
      for (std::size_t i = 0; i < width; ++i) not_above[i] += distance <= distances[i] ? 1 : 0;
    }
    const auto wanted = static_cast<Count>(k_);
    for (std::size_t i = 0; i < width; ++i) distances[i] = not_above[i] >= wanted ? distances[i] : far;
    for (std::size_t half = width / 2; half > 0; half /= 2)
      for (std::size_t i = 0; i < half; ++i)
        distances[i] = distances[i + half] < distances[i] ? distances[i + half] : distances[i];
    return distances[0];
  }

  [[nodiscard]] Scalar kth_of_many(std::size_t count) {
    sorted_.clear();
    sorted_.append({candidates_.data(), count});
    Scalar* const kth = sorted_.data() + (k_ - 1);
    std::nth_element(sorted_.data(), kth, sorted_.data() + count);
    return *kth;
  }

  [[nodiscard]] static std::ptrdiff_t to_difference(std::size_t count) { return static_cast<std::ptrdiff_t>(count); }

  static constexpr std::size_t spare = 12;  ///< how many more than k need not be separated by a tighter bound

  const Tree* tree_;
  detail::TreeLeaves<Tree> leaves_;
  std::size_t k_;
  Scalar max_distance_;
  Scalar limit_;                  ///< the first squared distance that is too far
  Scalar reach_ = 0, guess_ = 0;  ///< squared: for the next leaf, the next point
  typename detail::TreeLeaves<Tree>::Corner low_{}, high_{};
  std::vector<Index> near_;
  std::array<std::vector<Scalar>, 3> block_;  ///< what is gathered, in columns, and some that are infinitely far
  std::size_t gathered_ = 0;
  std::vector<Scalar> squared_;          ///< distances of the block to a point
  detail::Table<std::uint32_t> chosen_;  ///< places in the block, and how many of them are meant
  std::size_t chosen_count_ = 0;
  std::vector<Scalar> candidates_;
  detail::Table<Scalar> sorted_;
  std::vector<Neighbor<Scalar>> found_;
  Scalar farthest_ = 0;
};

}  // namespace chainslam
