#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cassert>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/core/compiled.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/detail/box_build.hpp"
#include "chainslam/search/detail/box_erase.hpp"
#include "chainslam/search/detail/box_insert.hpp"
#include "chainslam/search/detail/box_search.hpp"
#include "chainslam/search/detail/box_tree.hpp"
#include "chainslam/search/detail/box_visit.hpp"
#include "chainslam/search/detail/passes.hpp"
#include "chainslam/search/detail/thinning.hpp"
#include "chainslam/search/detail/tree_archive.hpp"
#include "chainslam/search/downsampling.hpp"
#include "chainslam/search/search_base.hpp"

namespace chainslam {

/// What an `IkdTree` has done: figures that a bound on its steps can be checked by.
struct IkdTreeWork {
  std::size_t moved_points = 0;  ///< points written to a place in a leaf
  std::size_t moved_links = 0;   ///< children written to a place in a node
  std::size_t swept_blocks = 0;  ///< blocks of voxels looked at for what erasures have emptied
};

/// Empty payload.
struct NoPayload {};

/// An incremental k-d tree: exact nearest neighbours of a map that grows by scans and forgets by boxes, after Xu et al.
/// 2022 (FAST-LIO2's ikd-Tree) in what it does, but a balanced tree of buckets in how.
///
/// Points lie in leaves of up to 32, in columns of eight, under nodes that hold the tight boxes of eight children side
/// by side, all leaves equally deep. A full leaf or node is split in two, as in a B-tree, so that the depth is bounded
/// for points in any order. A full node with few points below it is rebuilt, points and all, as a k-d tree is
/// built; one with many is parted by a plane that cuts what it crosses. Either is done at once, by the calling thread,
/// and to at most `step_budget()` points a level: no step is long. Erasing frees whole subtrees. With a downsampling
/// policy a table of voxels settles most insertions without a look at the tree; the blocks of it that an erasure has
/// emptied are known at once, and taken away by the insertions that follow, each of which looks at four.
///
/// Const calls may run on several threads, but not during a change; copying costs a copy of `memory()` bytes, so a
/// `Snapshot<IkdTree<...>>` lets readers go on while a writer changes its own. What is found and where points lie
/// depends on the history of changes alone.
///
/// @tparam Payload  trivially copyable; goes with each point, such as the caller's own index.
template <class ScalarType = float, DownsamplingPolicy Policy = KeepAll, int Dim = 3, class Payload = NoPayload>
class IkdTree : public IncrementalSearchBase<IkdTree<ScalarType, Policy, Dim, Payload>, ScalarType, Dim> {
  static_assert(Dim == 2 || Dim == 3, "IkdTree: points have two or three coordinates");
  static_assert(std::is_trivially_copyable_v<Payload> && std::is_default_constructible_v<Payload>,
                "IkdTree: Payload must be trivially copyable, such as an index into the caller's own data");
  using Base = IncrementalSearchBase<IkdTree, ScalarType, Dim>;
  friend Base;
  friend SearchBase<IkdTree, ScalarType, Dim>;

 public:
  using typename Base::Box;
  using typename Base::Scalar;
  using typename Base::Vector;

  /// @throws std::invalid_argument if the policy's numbers are out of range.
  explicit IkdTree(const Policy& policy = {}) : thinning_(policy) {}

  /// A tree of these points: `build(points)`.
  template <detail::PointSource<Dim> Points>
  explicit IkdTree(const Points& points, const Policy& policy = {}) : IkdTree(policy) {
    build(points);
  }

  IkdTree(const IkdTree&) = default;  ///< a copy is independent of its original
  /// Leaves `other` empty.
  IkdTree(IkdTree&& other) noexcept : thinning_(other.thinning_.policy()) { swap(other); }
  /// Takes the other's points, copied or moved.
  IkdTree& operator=(IkdTree other) noexcept {
    swap(other);
    return *this;
  }
  ~IkdTree() = default;
  /// Exchanges two trees in O(1).
  void swap(IkdTree& other) noexcept {
    std::swap(thinning_, other.thinning_);
    std::swap(tree_, other.tree_);
    std::swap(rejected_, other.rejected_);
  }

  /// The downsampling policy with its settings.
  [[nodiscard]] const Policy& downsampling() const { return thinning_.policy(); }
  [[nodiscard]] std::size_t size() const { return tree_.size; }  ///< number of points
  /// Points refused because a coordinate is NaN or infinite, or, when downsampling, 2^31 or more voxels from the
  /// origin.
  [[nodiscard]] Index rejected() const { return rejected_; }
  /// Bytes held, the voxels and free capacity included.
  [[nodiscard]] std::size_t memory() const { return tree_.memory() + thinning_.memory(); }
  /// Work done since the tree was made, or last asked to start at zero.
  [[nodiscard]] IkdTreeWork work() const { return {tree_.moved_points, tree_.moved_links, thinning_.swept()}; }
  /// Sets the figures of `work()` to zero.
  void reset_work() {
    tree_.moved_points = tree_.moved_links = 0;
    thinning_.reset_swept();
  }
  /// Maximum number of points rebuilt or split per insertion and level; bounds the worst-case latency.
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

  /// Inserts the points in their order; into an empty tree that keeps all, at once. Returns by how much `size()` grew.
  template <detail::PointSource<Dim> Points>
  Index insert(const Points& points) {
    if (Thinning::thins || size() > 0) return insert_all(points, [](Index) { return Payload(); });
    build(points);
    return static_cast<Index>(size());
  }
  /// Takes a point as the policy says. Returns whether p has become a point.
  bool insert(const Vector& p, const Payload& payload = {}) { return put(p, payload, thinning_.where(p)); }
  /// Inserts the points in their order, each with its payload. Returns by how much `size()` grew.
  /// @throws std::invalid_argument if there are not as many payloads as points.
  template <detail::PointSource<Dim> Points>
  Index insert(const Points& points, std::span<const Payload> payloads);

  /// Erases a point. Returns false if there is none with this index.
  bool erase(Index i);
  /// Erases the points for which `leaves(index, position)` holds, which must not throw. Returns how many went.
  template <class Predicate>
  Index erase_if(Predicate&& leaves) {
    return erase_where(detail::Somewhere{}, [&](detail::RunLink run, std::uint32_t count) {
      std::uint32_t leaving = 0;
      for (std::uint32_t lane = 0; lane < count; ++lane)
        leaving |= std::uint32_t{leaves(run.slot(lane), position(run.slot(lane)))} << lane;
      return leaving;
    });
  }
  void clear();  ///< erases everything

  /// The points with all that goes with them, as bytes that are the same on every machine (but for payloads, which are
  /// taken as they lie in memory); see detail/tree_archive.hpp.
  [[nodiscard]] std::vector<std::byte> save() const;
  /// A tree of what was saved: the same points, in places of its own.
  ///
  /// @param name  of where the bytes came from, for messages.
  /// @throws IoError if the bytes are not whole, or were saved with other template parameters or voxels.
  [[nodiscard]] static IkdTree load(std::span<const std::byte> bytes, const Policy& policy = {},
                                    const std::string& name = "saved IkdTree");

  /// Calls `visit(index, position)` for every point.
  template <class Visit>
  void for_each_point(Visit&& visit) const {
    visit_region(detail::Everywhere{}, visit);
  }

 private:
  using Tree = detail::BoxTree<Scalar, Dim, Payload>;
  using Point = typename Tree::Point;
  using Thinning = detail::Thinning<Scalar, Dim, Policy>;

  [[nodiscard]] static Point tree_point(const Vector& p, const Payload& payload) {
    Point point{{}, payload};
    std::copy_n(p.data(), Dim, point.at.begin());
    return point;
  }
  [[nodiscard]] detail::BoxTreeInserter<Tree> inserter() { return detail::BoxTreeInserter<Tree>(tree_); }
  template <class Points, class PayloadOf>
  Index insert_all(const Points& points, PayloadOf&& payload_of);
  bool put(const Vector& p, const Payload& payload, const typename Thinning::Where& at);
  [[nodiscard]] bool meet(const typename Thinning::Where& at, const Vector& p, const Payload& payload);
  [[nodiscard]] detail::TreeHeader header() const;

  template <class Collector>
  void search(const Vector& query, Collector& found) const {
    if (is_finite(query)) detail::search_nearest(tree_, query.data(), found);
  }
  /// Erases the points of a region that `leaving(run, count)` names among a leaf's.
  template <class Region, class Leaving>
  Index erase_where(const Region& region, const Leaving& leaving);
  template <class Region>
  Index erase_region(const Region& region) {
    return erase_where(region, [&](detail::RunLink run, std::uint32_t count) {
      return detail::contained_lanes(region, tree_.runs, run, count);
    });
  }
  template <class Region, class Visit>
  void visit_region(const Region& region, Visit&& visit) const {
    if (tree_.height > 0) detail::visit_below(tree_, tree_.root, tree_.height - 1, region, visit);
  }

  [[no_unique_address]] Thinning thinning_;
  Tree tree_;
  Index rejected_ = 0;
};
static_assert(IncrementalSearch<IkdTree<>> && SeededSearch<IkdTree<>> && FixedSizeSearch<IkdTree<>>);

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
  if constexpr (Thinning::thins) {
    insert(points);
  } else {
    const Index count = detail::source_size<Dim>(points);
    std::vector<Point> finite(static_cast<std::size_t>(count));
    std::size_t taken = 0;
    for (Index i = 0; i < count; ++i) {
      const Vector p = detail::source_position<Scalar, Dim>(points, i);
      if (is_finite(p))
        finite[taken++] = tree_point(p, {});
      else
        ++rejected_;
    }
    detail::BoxTreeBuilder<Tree>::build(tree_, {finite.data(), taken});
  }
}

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
bool IkdTree<ScalarType, Policy, Dim, Payload>::put(const Vector& p, const Payload& payload,
                                                    const typename Thinning::Where& at) {
  if (!at.there()) {
    ++rejected_;
    return false;
  }
  const VoxelVerdict verdict = thinning_.offer(at);
  if (verdict == VoxelVerdict::add) inserter().insert(tree_point(p, payload));
  return verdict == VoxelVerdict::add || (verdict == VoxelVerdict::meet && meet(at, p, payload));
}

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
template <detail::PointSource<Dim> Points>
Index IkdTree<ScalarType, Policy, Dim, Payload>::insert(const Points& points, std::span<const Payload> payloads) {
  if (payloads.size() != static_cast<std::size_t>(detail::source_size<Dim>(points)))
    throw std::invalid_argument("IkdTree: as many payloads as points are needed");
  return insert_all(points, [&](Index i) -> const Payload& { return payloads[static_cast<std::size_t>(i)]; });
}

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
template <class Points, class PayloadOf>
Index IkdTree<ScalarType, Policy, Dim, Payload>::insert_all(const Points& points, PayloadOf&& payload_of) {
  using Ahead = typename Thinning::Ahead;
  const std::size_t before = size();
  const auto point = [&](Index i) -> Vector { return detail::source_position<Scalar, Dim>(points, i); };
  detail::in_passes(
      detail::source_size<Dim>(points), [&](Index i) { return thinning_.where_ahead(point(i)); },
      [&](const Ahead& ahead) { thinning_.fetch(ahead); },
      [&](Index i, const Ahead& ahead) { put(point(i), payload_of(i), ahead.at); });
  return static_cast<Index>(size() - before);
}

/// Returns whether p has taken the place of its voxel's point.
template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
bool IkdTree<ScalarType, Policy, Dim, Payload>::meet(const typename Thinning::Where& at, const Vector& p,
                                                     const Payload& payload) {
  if constexpr (Thinning::thins) {
    typename Tree::Path path;
    const Index slot = detail::find_point(tree_, thinning_.box_of(at), path,
                                          [&](Index i) { return thinning_.in_voxel(tree_.runs.position(i), at); });
    assert(slot >= 0);
    Vector held = tree_.runs.position(slot);
    if (!thinning_.meet(at, held, p)) return false;
    const bool replaced = held == p;
    inserter().replace(path, slot, tree_point(held, replaced ? payload : tree_.runs.payload(slot)));
    return replaced;
  } else {
    return false;
  }
}

// ---- erasing ----

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
template <class Region, class Leaving>
Index IkdTree<ScalarType, Policy, Dim, Payload>::erase_where(const Region& region, const Leaving& leaving) {
  detail::BoxTreeEraser eraser(tree_, region, leaving, thinning_);
  const std::size_t erased = eraser.run();
  if (eraser.erased_untold()) thinning_.forget_inside(region, eraser.untold());
  return static_cast<Index>(erased);
}

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
bool IkdTree<ScalarType, Policy, Dim, Payload>::erase(Index i) {
  if (!contains(i)) return false;
  const detail::PointRegion<Scalar, Dim> region{position(i)};
  return erase_where(region, [i](detail::RunLink run, std::uint32_t count) {
           const auto lane = static_cast<std::uint32_t>(i) - static_cast<std::uint32_t>(run.slot(0));
           return lane < count ? 1U << lane : 0U;
         }) == 1;
}

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
void IkdTree<ScalarType, Policy, Dim, Payload>::clear() {
  IkdTree empty(downsampling());
  empty.rejected_ = rejected_;
  empty.set_step_budget(step_budget());
  swap(empty);
}

// ---- saving ----

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
detail::TreeHeader IkdTree<ScalarType, Policy, Dim, Payload>::header() const {
  detail::TreeHeader header;
  header.scalar_bytes = sizeof(Scalar);
  header.dimension = Dim;
  header.state_bytes = Thinning::saves_states ? 2 : 0;
  header.payload_bytes = Tree::Runs::has_payload ? sizeof(Payload) : 0;
  header.rejected = static_cast<std::uint32_t>(rejected_);
  header.voxel_size = thinning_.voxel_size();
  header.points = size();
  return header;
}

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
std::vector<std::byte> IkdTree<ScalarType, Policy, Dim, Payload>::save() const {
  const detail::TreeHeader head = header();
  ByteSink out(detail::TreeHeader::bytes + head.bytes_per_point() * size());
  put_header(out, head);
  for_each_point([&](Index, const Vector& p) {
    for (Eigen::Index axis = 0; axis < Dim; ++axis) out.put(p[axis]);
  });
  if constexpr (Thinning::saves_states)
    for_each_point([&](Index, const Vector& p) { out.put(static_cast<std::uint16_t>(thinning_.state_of(p))); });
  if constexpr (Tree::Runs::has_payload) for_each_point([&](Index i, const Vector&) { out.put_raw(payload(i)); });
  seal(out.bytes(), detail::tree_check_at);
  return std::move(out.bytes());
}

template <class ScalarType, DownsamplingPolicy Policy, int Dim, class Payload>
auto IkdTree<ScalarType, Policy, Dim, Payload>::load(std::span<const std::byte> bytes, const Policy& policy,
                                                     const std::string& name) -> IkdTree {
  IkdTree tree(policy);
  const detail::TreeHeader head = detail::check_tree(bytes, tree.header(), name);
  const auto count = static_cast<std::size_t>(head.points);
  ByteSource coordinates(bytes.subspan(detail::TreeHeader::bytes));
  ByteSource states(bytes.subspan(detail::TreeHeader::bytes + count * sizeof(Scalar) * Dim));
  ByteSource payloads(bytes.last(count * head.payload_bytes));
  std::vector<Point> points(count);
  for (std::size_t i = 0; i < count; ++i) {
    for (Scalar& coordinate : points[i].at) coordinate = coordinates.take<Scalar>();
    const unsigned state = Thinning::saves_states ? states.take<std::uint16_t>() : 0;
    if constexpr (Tree::Runs::has_payload) points[i].payload = payloads.take_raw<Payload>();
    if (!tree.thinning_.restore(Vector(points[i].at.data()), state))
      detail::refuse_tree(name, detail::TreeHeader::bytes + i * sizeof(Scalar) * Dim, "a point against the voxels");
  }
  detail::BoxTreeBuilder<Tree>::build(tree.tree_, {points.data(), points.size()});
  tree.rejected_ = static_cast<Index>(head.rejected);
  return tree;
}

#ifdef CHAINSLAM_COMPILED
extern template class IkdTree<float>;
#endif

}  // namespace chainslam
