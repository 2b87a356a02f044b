#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cassert>
#include <cstddef>
#include <limits>
#include <optional>
#include <span>
#include <stdexcept>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/core/finite.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/detail/box_build.hpp"
#include "chainslam/search/detail/box_erase.hpp"
#include "chainslam/search/detail/box_insert.hpp"
#include "chainslam/search/detail/box_search.hpp"
#include "chainslam/search/detail/box_tree.hpp"
#include "chainslam/search/detail/box_visit.hpp"
#include "chainslam/search/detail/search_verbs.hpp"
#include "chainslam/search/detail/voxel_states.hpp"
#include "chainslam/search/downsampling.hpp"

namespace chainslam {

/// What an `IkdTree` has done: figures that a bound on its steps can be checked by.
struct IkdTreeWork {
  std::size_t moved_points = 0;  ///< points written to a place in a leaf
  std::size_t moved_links = 0;   ///< children written to a place in a node
};

/// Nothing beside the position.
struct NoPayload {};

/// An incremental k-d tree: exact nearest neighbours of a map that grows by scans and forgets by boxes, after Xu et al.
/// 2022 (FAST-LIO2's ikd-Tree) in what it does, but a balanced tree of buckets in how.
///
/// Points lie in leaves of up to 32, in columns of eight, under nodes that hold the tight boxes of eight children side
/// by side. A full leaf or node is split in two, as in a B-tree: no insertion moves more than one leaf's points and
/// some links a level, there is nothing to rebuild, now or later, no second thread, and depth is bounded for points in
/// any order. Erasing frees whole subtrees. With a downsampling policy a table of voxels settles most insertions
/// without a look at the tree.
///
/// Const calls may run on several threads, but not during a change; copying costs a copy of `memory()` bytes, so a
/// `Snapshot<IkdTree<...>>` lets readers go on while a writer changes its own. What is found and where points lie
/// depends on the history of changes alone.
///
/// @tparam Payload  trivially copyable; goes with each point, such as the caller's own index.
template <class ScalarType = float, DownsamplingPolicy Policy = KeepAll, int Dim = 3, class Payload = NoPayload>
class IkdTree : public detail::IncrementalVerbs<IkdTree<ScalarType, Policy, Dim, Payload>, ScalarType, Dim> {
  static_assert(Dim == 2 || Dim == 3, "IkdTree: points have two or three coordinates");
  static_assert(std::is_trivially_copyable_v<Payload> && std::is_default_constructible_v<Payload>,
                "IkdTree: Payload must be trivially copyable, such as an index into the caller's own data");
  using Base = detail::IncrementalVerbs<IkdTree, ScalarType, Dim>;
  friend Base;
  friend detail::SearchVerbs<IkdTree, ScalarType, Dim>;

 public:
  using typename Base::Box;
  using typename Base::Scalar;
  using typename Base::Vector;

  /// @throws std::invalid_argument if the policy's numbers are out of range.
  explicit IkdTree(const Policy& policy = {}) : policy_(policy) { require_valid(policy); }

  /// A tree of these points: `build(points)`.
  template <detail::PointSource<Dim> Points>
  explicit IkdTree(const Points& points, const Policy& policy = {}) : IkdTree(policy) {
    build(points);
  }

  IkdTree(const IkdTree&) = default;
  /// Leaves `other` empty.
  IkdTree(IkdTree&& other) noexcept : policy_(other.policy_) { swap(other); }
  IkdTree& operator=(IkdTree other) noexcept {
    swap(other);
    return *this;
  }
  ~IkdTree() = default;
  void swap(IkdTree& other) noexcept {
    std::swap(policy_, other.policy_);
    std::swap(tree_, other.tree_);
    std::swap(voxels_, other.voxels_);
    std::swap(rejected_, other.rejected_);
  }

  [[nodiscard]] const Policy& downsampling() const { return policy_; }
  [[nodiscard]] std::size_t size() const { return tree_.size; }
  /// Points refused because a coordinate is NaN or infinite, or, when downsampling, 2^31 or more voxels from the
  /// origin.
  [[nodiscard]] Index rejected() const { return rejected_; }
  /// Bytes held, the voxels and free room included.
  [[nodiscard]] std::size_t memory() const { return tree_.memory() + voxels_.memory(); }
  /// Work done since the tree was made, or last asked to start at zero.
  [[nodiscard]] IkdTreeWork work() const { return {tree_.moved_points, tree_.moved_links}; }
  void reset_work() { tree_.moved_points = tree_.moved_links = 0; }
  /// How many points one insertion may sort anew, once in many; the length of the longest step is bounded by that.
  [[nodiscard]] Index step_budget() const { return static_cast<Index>(tree_.budget); }
  /// Fewer points make the longest step shorter, and searches a little slower.
  /// @throws std::invalid_argument if `points` is negative.
  void set_step_budget(Index points) {
    if (points < 0) throw std::invalid_argument("IkdTree: the budget of a step must not be negative");
    tree_.budget = static_cast<std::size_t>(points);
  }
  /// Levels of nodes above the leaves.
  [[nodiscard]] std::size_t height() const { return tree_.height; }

  /// Whether i is the index of a point.
  [[nodiscard]] bool contains(Index i) const { return tree_.runs.contains(i); }
  /// Position of a point that a search has returned.
  [[nodiscard]] Vector position(Index i) const {
    assert(contains(i));
    return tree_.runs.position(i);
  }
  /// What was inserted with the point.
  [[nodiscard]] Payload payload(Index i) const {
    assert(contains(i));
    return tree_.runs.payload(i);
  }
  /// The smallest box that holds the points, known without a look at them.
  [[nodiscard]] Box bounding_box() const;

  /// Replaces what there is by these points; all at once, which is faster than one by one, where none are left out.
  template <detail::PointSource<Dim> Points>
  void build(const Points& points);

  using Base::insert;
  /// Takes a point as the policy says. Returns whether p has become a point.
  bool insert(const Vector& p, const Payload& payload = {});
  /// Inserts the points in their order, each with its payload. Returns by how much `size()` grew.
  /// @throws std::invalid_argument if there are not as many payloads as points.
  template <detail::PointSource<Dim> Points>
  Index insert(const Points& points, std::span<const Payload> payloads);

  /// Erases a point. Returns false if there is none with this index.
  bool erase(Index i);
  /// Erases the points for which `leaves(index, position)` holds, which must not throw. Returns how many went.
  template <class Predicate>
  Index erase_if(Predicate&& leaves) {
    return erase_where(detail::Somewhere{}, leaves);
  }
  void clear();

  /// Calls `visit(index, position)` for every point.
  template <class Visit>
  void for_each_point(Visit&& visit) const {
    visit_region(detail::Everywhere{}, visit);
  }

 private:
  static constexpr bool downsamples = VoxelPolicy<Policy>;
  struct NoVoxels {
    [[nodiscard]] std::size_t memory() const { return 0; }
  };
  template <class P>
  struct VoxelsOf {
    using Type = NoVoxels;
  };
  template <VoxelPolicy P>
  struct VoxelsOf<P> {
    using Type = detail::VoxelStates<P::state_bits>;
  };
  using Tree = detail::BoxTree<Scalar, Dim, Payload>;
  using Point = typename Tree::Point;

  /// A point's voxel, and its squared distance from the voxel's centre in voxel sizes.
  struct InVoxel {
    Cell cell;
    double offset;
  };

  [[nodiscard]] static Point tree_point(const Vector& p, const Payload& payload) {
    Point point{{}, payload};
    std::copy_n(p.data(), Dim, point.at.begin());
    return point;
  }
  [[nodiscard]] detail::BoxTreeInserter<Tree> inserter() { return detail::BoxTreeInserter<Tree>(tree_); }
  [[nodiscard]] std::optional<InVoxel> in_voxel(const Vector& p) const;
  [[nodiscard]] bool offer(const InVoxel& where, const Vector& p, const Payload& payload);
  [[nodiscard]] bool meet(const InVoxel& where, unsigned& state, const Vector& p, const Payload& payload);
  void forget(const Vector& p);

  template <class Collector>
  void search(const Vector& query, Collector& found) const {
    if (is_finite(query)) detail::search_nearest(tree_, query.data(), found);
  }
  template <class Region, class Leaves>
  Index erase_where(const Region& region, Leaves& leaves);
  template <class Region>
  Index erase_region(const Region& region) {
    const auto leaves = [&](Index, const Vector& p) { return region.contains(p); };
    return erase_where(region, leaves);
  }
  template <class Region, class Visit>
  void visit_region(const Region& region, Visit&& visit) const {
    if (tree_.height > 0) detail::visit_below(tree_, tree_.root, tree_.height - 1, region, visit);
  }

  [[no_unique_address]] Policy policy_;
  Tree tree_;
  [[no_unique_address]] typename VoxelsOf<Policy>::Type voxels_;
  Index rejected_ = 0;
};
static_assert(IncrementalSearch<IkdTree<float>> && IncrementalSearch<IkdTree<double, NearestToCenter, 2>>);
static_assert(SeededSearch<IkdTree<float>> && FixedSizeSearch<IkdTree<float>>);

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
auto IkdTree<ScalarType, Policy, Dim, Payload>::bounding_box() const -> Box {
  Box box;
  if (tree_.height == 0) return box;
  const auto bounds = tree_.at(tree_.root).box();
  std::copy_n(bounds.low.data(), Dim, box.min().data());
  std::copy_n(bounds.high.data(), Dim, box.max().data());
  return box;
}

// ---- inserting ----

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
template <detail::PointSource<Dim> Points>
void IkdTree<ScalarType, Policy, Dim, Payload>::build(const Points& points) {
  clear();
  if constexpr (downsamples) {
    insert(points);
  } else {
    const Index count = detail::source_size<Dim>(points);
    std::vector<Point> finite;
    finite.reserve(static_cast<std::size_t>(count));
    for (Index i = 0; i < count; ++i) {
      const Vector p = detail::source_position<Scalar, Dim>(points, i);
      if (is_finite(p))
        finite.push_back(tree_point(p, {}));
      else
        ++rejected_;
    }
    detail::BoxTreeBuilder<Tree>::build(tree_, finite);
  }
}

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
bool IkdTree<ScalarType, Policy, Dim, Payload>::insert(const Vector& p, const Payload& payload) {
  if constexpr (downsamples) {
    if (const std::optional<InVoxel> where = in_voxel(p)) return offer(*where, p, payload);
  } else if (is_finite(p)) {
    inserter().insert(tree_point(p, payload));
    return true;
  }
  ++rejected_;
  return false;
}

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
template <detail::PointSource<Dim> Points>
Index IkdTree<ScalarType, Policy, Dim, Payload>::insert(const Points& points, std::span<const Payload> payloads) {
  const Index count = detail::source_size<Dim>(points);
  if (payloads.size() != static_cast<std::size_t>(count))
    throw std::invalid_argument("IkdTree: as many payloads as points are needed");
  const std::size_t before = size();
  for (Index i = 0; i < count; ++i)
    insert(detail::source_position<Scalar, Dim>(points, i), payloads[static_cast<std::size_t>(i)]);
  return static_cast<Index>(size() - before);
}

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
auto IkdTree<ScalarType, Policy, Dim, Payload>::in_voxel(const Vector& p) const -> std::optional<InVoxel> {
  Eigen::Vector3d scaled = Eigen::Vector3d::Constant(0.5);
  scaled.head<Dim>() = p.template cast<double>() * (1.0 / policy_.voxel_size);
  const std::optional<Cell> cell = cell_of(scaled);
  if (!cell) return std::nullopt;
  return InVoxel{*cell, (scaled - Eigen::Vector3d(cell->x + 0.5, cell->y + 0.5, cell->z + 0.5)).squaredNorm()};
}

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
bool IkdTree<ScalarType, Policy, Dim, Payload>::offer(const InVoxel& where, const Vector& p, const Payload& payload) {
  const auto place = voxels_.find_or_add(where.cell);
  if (!voxels_.occupied(place)) {
    voxels_.occupy(place, policy_.first_state(where.offset));
    inserter().insert(tree_point(p, payload));
    return true;
  }
  unsigned state = voxels_.state(place);
  const VoxelVerdict verdict = policy_.judge(state, where.offset);
  bool taken = verdict == VoxelVerdict::add;
  if (taken) inserter().insert(tree_point(p, payload));
  if (verdict == VoxelVerdict::meet) taken = meet(where, state, p, payload);
  voxels_.set_state(place, state);
  return taken;
}

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
bool IkdTree<ScalarType, Policy, Dim, Payload>::meet(const InVoxel& where, unsigned& state, const Vector& p,
                                                     const Payload& payload) {
  if constexpr (requires(Vector & held) { policy_.meet(state, held, 0.0, p, 0.0); }) {
    const std::array<double, 3> corner{1.0 * where.cell.x, 1.0 * where.cell.y, 1.0 * where.cell.z};
    typename Tree::Box box;
    for (std::size_t axis = 0; axis < Dim; ++axis) {
      const double slack =
          4 * static_cast<double>(std::numeric_limits<Scalar>::epsilon()) * (std::abs(corner[axis]) + 1);
      box.low[axis] = static_cast<Scalar>((corner[axis] - slack) * policy_.voxel_size);
      box.high[axis] = static_cast<Scalar>((corner[axis] + 1 + slack) * policy_.voxel_size);
    }
    typename Tree::Path path;
    double held_offset = 0;
    const Index slot = detail::find_point(tree_, box, path, [&](Index i) {
      const std::optional<InVoxel> found = in_voxel(tree_.runs.position(i));
      held_offset = found->offset;
      return found->cell == where.cell;
    });
    assert(slot >= 0);
    Vector held = tree_.runs.position(slot);
    if (!policy_.meet(state, held, held_offset, p, where.offset)) return false;
    const std::optional<InVoxel> now = in_voxel(held);
    if (!now || !(now->cell == where.cell)) return false;  // a mean that rounding took out of its voxel
    const bool replaced = held == p;
    inserter().replace(path, slot, tree_point(held, replaced ? payload : tree_.runs.payload(slot)));
    return replaced;
  } else {
    return false;
  }
}

// ---- erasing ----

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
template <class Region, class Leaves>
Index IkdTree<ScalarType, Policy, Dim, Payload>::erase_where(const Region& region, Leaves& leaves) {
  if constexpr (downsamples) {
    constexpr double block_and_rounding = 1.001 * detail::VoxelStates<Policy::state_bits>::edge;
    const auto gone = [this](const Vector& p) { forget(p); };
    detail::BoxTreeEraser eraser(tree_, region, leaves, gone, block_and_rounding * policy_.voxel_size);
    const std::size_t erased = eraser.run();
    if (eraser.erased_untold()) voxels_.template vacate_inside<Dim>(region, policy_.voxel_size);
    return static_cast<Index>(erased);
  } else {
    const auto gone = [](const Vector&) {};
    detail::BoxTreeEraser eraser(tree_, region, leaves, gone, 0.0);
    return static_cast<Index>(eraser.run());
  }
}

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
bool IkdTree<ScalarType, Policy, Dim, Payload>::erase(Index i) {
  if (!contains(i)) return false;
  const Vector p = position(i);
  const detail::PointRegion<Scalar, Dim> region{p};
  const auto leaves = [i](Index slot, const Vector&) { return slot == i; };
  return erase_where(region, leaves) == 1;
}

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
void IkdTree<ScalarType, Policy, Dim, Payload>::forget(const Vector& p) {
  const auto place = voxels_.find(in_voxel(p)->cell);
  unsigned state = voxels_.state(place);
  if (policy_.forget(state))
    voxels_.set_state(place, state);
  else
    voxels_.vacate(place);
}

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
void IkdTree<ScalarType, Policy, Dim, Payload>::clear() {
  IkdTree empty(policy_);
  empty.rejected_ = rejected_;
  empty.set_step_budget(step_budget());
  swap(empty);
}

}  // namespace chainslam
