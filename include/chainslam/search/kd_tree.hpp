#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <bit>
#include <cassert>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/finite.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/detail/lanes.hpp"
#include "chainslam/search/detail/nearest_list.hpp"

namespace chainslam {

/// A static k-d tree with buckets: built once from a cloud, then exact nearest neighbours and radius search.
///
/// The tree is balanced and has no links: nodes lie in heap order (children of i: 2i + 1, 2i + 2), 8 bytes each for
/// float, leaves behind them. A leaf holds up to 16 points in columns. Every node is split at the median of its widest
/// axis. Searching prunes by the distance to the cell, kept per axis (Arya and Mount 1993), with a stack of its own.
/// Copies of the points and all book-keeping take about 22 bytes a point for float.
///
/// Const calls may run on several threads. Indices are the cloud's.
template <class ScalarType = float>
class KdTree {
 public:
  using Scalar = ScalarType;
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;

  KdTree() = default;

  /// @param cloud  points in any frame, metres; NaN and infinite ones are left out and counted.
  template <Cloud Points>
  explicit KdTree(const Points& cloud);

  /// Points that can be found.
  [[nodiscard]] std::size_t size() const { return slot_of_point_.size() - static_cast<std::size_t>(rejected_); }
  /// Points left out because a coordinate is NaN or infinite.
  [[nodiscard]] Index rejected() const { return rejected_; }

  /// Position of a point that is in the tree.
  [[nodiscard]] Vector3 position(Index i) const {
    const Index slot = slot_of_point_[static_cast<std::size_t>(i)];
    assert(slot >= 0);
    return leaves_[static_cast<std::size_t>(slot / leaf_size)].points.position(slot % leaf_size);
  }

  /// See `NearestNeighborSearch`. A bound in `max_distance`, such as the last match's distance, makes it faster.
  Index knn(const Vector3& query, std::span<Neighbor<Scalar>> out,
            Scalar max_distance = std::numeric_limits<Scalar>::infinity()) const {
    detail::NearestList<Scalar> found(out, max_distance);
    search(query, found);
    return found.size();
  }

  void within(const Vector3& query, Scalar radius, std::vector<Neighbor<Scalar>>& out) const {
    detail::RadiusList<Scalar> found(out, radius);
    search(query, found);
  }

 private:
  static constexpr int leaf_size = 16;
  static constexpr int max_depth = 32;

  struct Node {
    Scalar split;
    std::int32_t axis;
  };
  struct Leaf {
    detail::Lanes<Scalar, leaf_size> points;
    std::array<Index, leaf_size> indices;
  };
  struct Item {
    std::array<Scalar, 3> p;
    Index index;
  };
  /// A subtree put aside: where the query lies from its cell, axis by axis, and that distance squared.
  struct Pending {
    std::array<Scalar, 3> offset;
    Scalar bound;
    std::size_t node;
  };

  template <Cloud Points>
  [[nodiscard]] std::vector<Item> finite_items(const Points& cloud);
  void build(std::size_t node, std::span<Item> items);
  void fill_leaf(std::size_t leaf, std::span<const Item> items);
  template <class Collector>
  void search(const Vector3& query, Collector& found) const;

  [[nodiscard]] static std::int32_t widest_axis(std::span<const Item> items);
  /// The same sum in the same order as for points, so that rounding never makes a cell farther than what it holds.
  [[nodiscard]] static Scalar squared(const std::array<Scalar, 3>& v) {
    return v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
  }

  std::vector<Node> nodes_;
  std::vector<Leaf> leaves_;
  std::vector<Index> slot_of_point_;  ///< leaf * leaf_size + lane, or -1 if left out
  Index rejected_ = 0;
};
static_assert(NearestNeighborSearch<KdTree<float>> && NearestNeighborSearch<KdTree<double>>);

template <class ScalarType>
template <Cloud Points>
KdTree<ScalarType>::KdTree(const Points& cloud) {
  std::vector<Item> items = finite_items(cloud);
  if (items.empty()) return;
  const std::size_t leaf_count = std::bit_ceil((items.size() + leaf_size - 1) / leaf_size);
  nodes_.resize(leaf_count - 1);
  leaves_.resize(leaf_count);
  build(0, items);
}

template <class ScalarType>
template <Cloud Points>
auto KdTree<ScalarType>::finite_items(const Points& cloud) -> std::vector<Item> {
  const Index count = to_index(cloud_size(cloud), "cloud");
  slot_of_point_.resize(static_cast<std::size_t>(count), -1);
  std::vector<Item> items;
  items.reserve(static_cast<std::size_t>(count));
  for (Index i = 0; i < count; ++i) {
    const Vector3 p = chainslam::position(cloud, static_cast<std::size_t>(i)).template cast<Scalar>();
    if (is_finite(p))
      items.push_back({{p[0], p[1], p[2]}, i});
    else
      ++rejected_;
  }
  return items;
}

template <class ScalarType>
std::int32_t KdTree<ScalarType>::widest_axis(std::span<const Item> items) {
  std::array<Scalar, 3> low = items[0].p, high = items[0].p;
  for (const Item& item : items) {
    for (std::size_t axis = 0; axis < 3; ++axis) {
      low[axis] = std::min(low[axis], item.p[axis]);
      high[axis] = std::max(high[axis], item.p[axis]);
    }
  }
  const Scalar x = high[0] - low[0], y = high[1] - low[1], z = high[2] - low[2];
  if (x >= y && x >= z) return 0;
  return y >= z ? 1 : 2;
}

template <class ScalarType>
void KdTree<ScalarType>::build(std::size_t node, std::span<Item> items) {
  if (node >= nodes_.size()) return fill_leaf(node - nodes_.size(), items);
  const std::int32_t axis = widest_axis(items);
  const auto a = static_cast<std::size_t>(axis);
  const std::size_t half = items.size() / 2;
  std::nth_element(items.begin(), items.begin() + static_cast<std::ptrdiff_t>(half), items.end(),
                   [a](const Item& left, const Item& right) { return left.p[a] < right.p[a]; });
  nodes_[node] = {items[half].p[a], axis};
  build(2 * node + 1, items.first(half));
  build(2 * node + 2, items.subspan(half));
}

template <class ScalarType>
void KdTree<ScalarType>::fill_leaf(std::size_t leaf, std::span<const Item> items) {
  for (std::size_t lane = 0; lane < items.size(); ++lane) {
    const Item& item = items[lane];
    leaves_[leaf].points.set(static_cast<int>(lane), item.p[0], item.p[1], item.p[2]);
    leaves_[leaf].indices[lane] = item.index;
    slot_of_point_[static_cast<std::size_t>(item.index)] = static_cast<Index>(leaf * leaf_size + lane);
  }
}

template <class ScalarType>
template <class Collector>
void KdTree<ScalarType>::search(const Vector3& query, Collector& found) const {
  if (leaves_.empty()) return;
  const std::array<Scalar, 3> q{query[0], query[1], query[2]};
  std::array<Pending, max_depth> stack;
  std::size_t pending = 0;
  std::array<Scalar, 3> offset{};
  std::size_t node = 0;
  for (;;) {
    while (node < nodes_.size()) {
      const Node& here = nodes_[node];
      const auto axis = static_cast<std::size_t>(here.axis);
      const Scalar beyond = q[axis] - here.split;
      const std::size_t right = beyond >= 0 ? 1 : 0;
      Pending& far = stack[pending];
      far.offset = offset;
      far.offset[axis] = beyond;
      far.bound = squared(far.offset);
      far.node = 2 * node + 2 - right;
      if (far.bound < found.bound()) ++pending;
      node = 2 * node + 1 + right;
    }
    const Leaf& leaf = leaves_[node - nodes_.size()];
    detail::scan(leaf.points, q.data(), found, [&](int lane) { return leaf.indices[static_cast<std::size_t>(lane)]; });
    do {
      if (pending == 0) return;
      --pending;
    } while (!(stack[pending].bound < found.bound()));
    node = stack[pending].node;
    offset = stack[pending].offset;
  }
}

}  // namespace chainslam
