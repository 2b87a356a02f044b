#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cassert>
#include <cstdint>
#include <span>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/compiled.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/detail/box_split.hpp"
#include "chainslam/search/detail/point_lanes.hpp"
#include "chainslam/search/detail/point_runs.hpp"
#include "chainslam/search/search_base.hpp"

namespace chainslam {

namespace detail {
template <class Tree>
class TreeLeaves;
}

/// A static k-d tree with buckets: built once from a cloud, then exact nearest neighbours and radius search.
///
/// A cell is split across its widest side in the middle of its points' box, which keeps cells compact where LiDAR
/// leaves lines of points (a median would make slivers), but gives neither side less than a quarter of the points,
/// which bounds the depth. Nodes lie in preorder with 32-bit links, leaves hold up to 32 points in columns. Searching
/// prunes by the distance to the cell, kept axis by axis (Arya and Mount 1993), with a stack of its own. All together
/// about 57 bytes a point for float.
///
/// Const calls may run on several threads. Indices are the cloud's.
template <class ScalarType = float, int Dim = 3>
class KdTree : public SearchBase<KdTree<ScalarType, Dim>, ScalarType, Dim> {
  friend SearchBase<KdTree, ScalarType, Dim>;
  friend class detail::TreeLeaves<KdTree>;

 public:
  using Scalar = ScalarType;                     ///< number type
  using Vector = Eigen::Matrix<Scalar, Dim, 1>;  ///< a point

  KdTree() = default;

  /// @param cloud  points in any frame, metres; NaN and infinite ones are left out and counted.
  template <detail::PointSource<Dim> Points>
  explicit KdTree(const Points& cloud);

  /// Points that can be found.
  [[nodiscard]] std::size_t size() const { return static_cast<std::size_t>(slot_of_point_.size() - rejected_); }
  /// Points left out because a coordinate is NaN or infinite.
  [[nodiscard]] Index rejected() const { return rejected_; }

  /// Whether point i of the cloud is in the tree.
  [[nodiscard]] bool contains(Index i) const { return i >= 0 && i < slot_of_point_.size() && slot_of_point_[i] >= 0; }
  /// Position of a point that is in the tree.
  [[nodiscard]] Vector position(Index i) const {
    const Index slot = slot_of_point_[i];
    assert(slot >= 0);
    return leaves_[slot / leaf_size].points.position(slot % leaf_size);
  }

 private:
  static constexpr auto dim = static_cast<std::size_t>(Dim);
  static constexpr int leaf_size = 32;
  /// No side of a split gets less than a quarter: depth <= log(2^31 / 32) / log(4 / 3) = 63.
  static constexpr std::size_t max_depth = 64;
  static constexpr std::uint32_t leaf_axis = 3;

  /// A split, or a reference to a leaf. The lower side of a split is the next node.
  struct Node {
    Scalar split;
    std::uint32_t packed;  ///< 4 * (the node of the upper side, or the leaf) + (axis, or leaf_axis)

    [[nodiscard]] std::uint32_t axis() const { return packed & 3; }
    [[nodiscard]] std::uint32_t link() const { return packed >> 2; }
  };
  struct alignas(64) Leaf {
    detail::Lanes<Scalar, leaf_size, Dim> points;
    std::array<Index, leaf_size> indices;
  };
  using Item = detail::TreePoint<Scalar, Dim, Index>;  ///< with its place in the cloud
  /// A subtree put aside: how far the query lies from its cell, axis by axis, and that distance squared.
  struct Pending {
    std::array<Scalar, dim> offset;
    Scalar bound;
    std::uint32_t node;
  };

  template <detail::PointSource<Dim> Points>
  [[nodiscard]] detail::Table<Item> finite_items(const Points& cloud);
  void build(std::span<Item> items, std::span<Item> scratch);
  void add_leaf(std::span<const Item> items);
  template <class Collector>
  void search(const Vector& query, Collector& found) const;

  /// The same sum in the same order as for points, so that rounding never makes a cell farther than what it holds.
  [[nodiscard]] static Scalar squared(const std::array<Scalar, dim>& v) {
    Scalar sum = v[0] * v[0] + v[1] * v[1];
    if constexpr (Dim == 3) sum += v[2] * v[2];
    return sum;
  }

  detail::Table<Node> nodes_;
  detail::Table<Leaf> leaves_;
  detail::Table<Index> slot_of_point_;  ///< leaf * leaf_size + lane, or -1 if left out
  Index rejected_ = 0;
};
static_assert(SeededSearch<KdTree<>> && FixedSizeSearch<KdTree<>>);

template <class ScalarType, int Dim>
template <detail::PointSource<Dim> Points>
KdTree<ScalarType, Dim>::KdTree(const Points& cloud) {
  detail::Table<Item> items = finite_items(cloud);
  if (items.empty()) return;
  const Offset expected_leaves = items.size() / 10 + 1;
  nodes_.reserve(2 * expected_leaves);
  leaves_.reserve(expected_leaves);
  detail::Table<Item> scratch(items.size());
  build(items.all(), scratch.all());
}

/// The finite points of a cloud.
template <class ScalarType, int Dim>
template <detail::PointSource<Dim> Points>
auto KdTree<ScalarType, Dim>::finite_items(const Points& cloud) -> detail::Table<Item> {
  const Index count = detail::source_size<Dim>(cloud);
  slot_of_point_.resize(count, -1);
  detail::Table<Item> items;
  items.reserve(count);
  for (Index i = 0; i < count; ++i) {
    const Vector p = detail::source_position<Scalar, Dim>(cloud, i);
    if (!is_finite(p)) {
      ++rejected_;
      continue;
    }
    Item& item = items.emplace_back();
    std::copy_n(p.data(), Dim, item.at.begin());
    item.payload = i;
  }
  return items;
}

template <class ScalarType, int Dim>
void KdTree<ScalarType, Dim>::build(std::span<Item> items, std::span<Item> scratch) {
  if (items.size() <= leaf_size) return add_leaf(items);
  const std::size_t quarter = items.size() / 4;
  const auto split = detail::split_points(items, scratch, quarter, items.size() - quarter);
  const Offset node = nodes_.size();
  nodes_.push_back({});
  build(items.first(split.below), scratch);
  nodes_[node] = {split.at, static_cast<std::uint32_t>(4 * static_cast<std::size_t>(nodes_.size()) + split.axis)};
  build(items.subspan(split.below), scratch);
}

template <class ScalarType, int Dim>
void KdTree<ScalarType, Dim>::add_leaf(std::span<const Item> items) {
  const Index first_slot = to_index((leaves_.size() + 1) * leaf_size, "KdTree") - leaf_size;
  nodes_.push_back({0, 4 * static_cast<std::uint32_t>(leaves_.size()) + leaf_axis});
  Leaf& leaf = leaves_.emplace_back();
  for (std::size_t lane = 0; lane < items.size(); ++lane) {
    const Item& item = items[lane];
    leaf.points.set(static_cast<int>(lane), item.at.data());
    leaf.indices[lane] = item.payload;
    slot_of_point_[item.payload] = first_slot + static_cast<Index>(lane);
  }
}

template <class ScalarType, int Dim>
template <class Collector>
void KdTree<ScalarType, Dim>::search(const Vector& query, Collector& found) const {
  if (nodes_.empty()) return;
  std::array<Scalar, dim> q;
  std::copy_n(query.data(), dim, q.begin());
  std::array<Pending, max_depth> stack;
  std::size_t pending = 0;
  std::array<Scalar, dim> offset{};
  std::uint32_t node = 0;
  for (;;) {
    Node here = nodes_[node];
    for (; here.axis() != leaf_axis; here = nodes_[node]) {
      const Scalar beyond = q[here.axis()] - here.split;
      const bool above = beyond >= 0;
      Pending& far = stack[pending];
      far.offset = offset;
      far.offset[here.axis()] = beyond;
      far.bound = squared(far.offset);
      far.node = above ? node + 1 : here.link();
      if (far.bound < found.bound()) ++pending;
      node = above ? here.link() : node + 1;
    }
    const Leaf& leaf = leaves_[here.link()];
    detail::scan(leaf.points, q.data(), found, [&](int lane) { return leaf.indices[static_cast<std::size_t>(lane)]; });
    do {
      if (pending == 0) return;
      --pending;
    } while (!(stack[pending].bound < found.bound()));
    node = stack[pending].node;
    offset = stack[pending].offset;
  }
}

#ifdef CHAINSLAM_COMPILED
extern template class KdTree<float>;
#endif

}  // namespace chainslam
