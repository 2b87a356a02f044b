#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "chainslam/search/detail/box_tree.hpp"
#include "chainslam/search/detail/regions.hpp"

namespace chainslam::detail {

template <class Scalar, int Dim>
[[nodiscard]] Eigen::AlignedBox<double, Dim> wide_box(const Bounds<Scalar, Dim>& box) {
  Eigen::AlignedBox<double, Dim> wide;
  for (std::size_t axis = 0; axis < static_cast<std::size_t>(Dim); ++axis) {
    wide.min()[static_cast<Eigen::Index>(axis)] = static_cast<double>(box.low[axis]);
    wide.max()[static_cast<Eigen::Index>(axis)] = static_cast<double>(box.high[axis]);
  }
  return wide;
}

/// Erases a region from a tree: what lies inside goes as whole subtrees, and only leaves on the rim are looked at point
/// by point. Small leaves and nodes left over join a sibling.
///
/// `region.overlap(box)` says how a box lies to the region, `leaves(slot, p)` decides for a point, `gone(p)` is told of
/// points that go, but not of those in a box for which all of `around(box)` lies in the region.
template <class Tree, class Region, class Leaves, class Gone, class Around>
class BoxTreeEraser {
 public:
  using Scalar = typename Tree::Scalar;
  using Node = typename Tree::Node;
  using Link = typename Tree::Link;
  using Box = typename Tree::Box;

  BoxTreeEraser(Tree& tree, const Region& region, Leaves& leaves, Gone& gone, Around& around)
      : tree_(tree), region_(region), leaves_(leaves), gone_(gone), around_(around) {}

  /// Returns how many points went.
  std::size_t run() {
    if (tree_.height == 0) return 0;
    const std::size_t before = tree_.size;
    visit(tree_.root, tree_.height - 1);
    while (tree_.height > 1 && tree_.at(tree_.root).count == 1) {
      const Link child = tree_.at(tree_.root).link[0];
      tree_.release_node(tree_.root);
      tree_.root = child;
      --tree_.height;
    }
    if (tree_.at(tree_.root).count == 0) {
      tree_.release_node(tree_.root);
      tree_.height = 0;
    }
    return before - tree_.size;
  }

  /// Whether there were points of which `gone` was not told, and a box around them.
  [[nodiscard]] bool erased_untold() const { return untold_.low[0] <= untold_.high[0]; }
  [[nodiscard]] const Box& untold() const { return untold_; }

 private:
  static constexpr std::size_t small_leaf = 8, joined_leaf = 24, small_node = 3, joined_node = Node::width;

  void visit(Link link, std::size_t level) {
    Node& node = tree_.at(link);
    unsigned changed = 0;  // lanes that hold less than before
    for (std::size_t lane = node.count; lane-- > 0;) {
      const Overlap overlap = region_.overlap(wide_box(node.box(lane)));
      if (overlap == Overlap::outside) continue;
      if (overlap == Overlap::inside)
        drop(node.entry(lane), level);
      else if (const std::size_t before = tree_.size;
               level == 0 ? filter_leaf(node, lane) : filter_node(node, lane, level)) {
        if (tree_.size != before) changed |= 1U << lane;
        continue;
      }
      remove(node, lane, changed);
    }
    if (changed != 0) join_small(node, level, changed);
  }

  /// Removes a child, and keeps up which have changed.
  static void remove(Node& node, std::size_t lane, unsigned& changed) {
    node.remove(lane);
    const unsigned last_changed = changed >> node.count & 1U;
    changed &= ~(1U << node.count | 1U << lane);
    if (lane != node.count) changed |= last_changed << lane;
  }

  /// Returns whether anything is left.
  [[nodiscard]] bool filter_node(Node& node, std::size_t lane, std::size_t level) {
    const Link child = node.link[lane];
    visit(child, level - 1);
    if (tree_.at(child).count == 0) {
      tree_.release_node(child);
      return false;
    }
    node.set_box(lane, tree_.at(child).box());
    return true;
  }

  [[nodiscard]] bool filter_leaf(Node& node, std::size_t lane) {
    const RunLink run(node.link[lane]);
    const std::uint32_t count = node.points[lane];
    std::uint32_t kept = 0;
    Box box;
    for (std::uint32_t i = 0; i < count; ++i) {
      const Index slot = run.slot(i);
      const auto p = tree_.runs.position(slot);
      if (leaves_(slot, p)) {
        gone_(p);
        continue;
      }
      const auto point = tree_.runs.get(slot);
      box.include(point.at);
      if (kept < i) tree_.runs.set(run.slot(kept), point);
      ++kept;
    }
    for (std::uint32_t i = kept; i < count; ++i) tree_.runs.clear_lane(run.slot(i));
    tree_.size -= count - kept;
    node.points[lane] = static_cast<std::uint8_t>(kept);
    if (kept == 0)
      tree_.runs.release(run);
    else
      node.set_box(lane, box);
    return kept > 0;
  }

  /// Frees all below a child that is erased as a whole; tells of the points unless all lie deep in the region.
  void drop(const typename Tree::Entry& child, std::size_t level) {
    const bool deep = region_.overlap(around_(child.box)) == Overlap::inside;
    if (deep) {
      untold_.include(child.box);
      return free_all(child, level);
    }
    if (level > 0) {
      const Node& node = tree_.at(child.link);
      for (std::size_t lane = 0; lane < node.count; ++lane) drop(node.entry(lane), level - 1);
      return tree_.release_node(child.link);
    }
    const RunLink run(child.link);
    for (std::uint32_t i = 0; i < child.points; ++i) gone_(tree_.runs.position(run.slot(i)));
    free_all(child, level);
  }

  void free_all(const typename Tree::Entry& child, std::size_t level) {
    if (level == 0) {
      tree_.runs.release(RunLink(child.link));
      tree_.size -= child.points;
      return;
    }
    const Node& node = tree_.at(child.link);
    for (std::size_t lane = 0; lane < node.count; ++lane) free_all(node.entry(lane), level - 1);
    tree_.release_node(child.link);
  }

  [[nodiscard]] std::size_t fill(const Node& node, std::size_t lane, std::size_t level) const {
    return level == 0 ? node.points[lane] : tree_.at(node.link[lane]).count;
  }

  /// Joins the children that have become small to siblings. Only those are looked at: the others lie in cold memory.
  void join_small(Node& node, std::size_t level, unsigned changed) {
    for (std::size_t lane = 0; lane < node.count;) {
      const bool small =
          (changed >> lane & 1U) != 0 && fill(node, lane, level) <= (level == 0 ? small_leaf : small_node);
      const std::size_t partner = small ? partner_of(node, lane, level) : node.count;
      if (partner == node.count) {
        ++lane;
        continue;
      }
      level == 0 ? join_leaves(node, partner, lane) : join_nodes(node, partner, lane);
      remove(node, lane, changed);
    }
  }

  /// The sibling that has room for a child and whose box grows least around it; `node.count` if there is none.
  [[nodiscard]] std::size_t partner_of(const Node& node, std::size_t lane, std::size_t level) const {
    const std::size_t most = level == 0 ? joined_leaf : joined_node;
    std::size_t best = node.count;
    Scalar best_growth = std::numeric_limits<Scalar>::infinity();
    for (std::size_t other = 0; other < node.count; ++other) {
      if (other == lane || fill(node, other, level) + fill(node, lane, level) > most) continue;
      Box joined = node.box(other);
      joined.include(node.box(lane));
      const Scalar growth = joined.margin() - node.box(other).margin();
      if (!(growth < best_growth)) continue;
      best = other;
      best_growth = growth;
    }
    return best;
  }

  void join_leaves(Node& node, std::size_t into, std::size_t from) {
    RunLink run(node.link[into]);
    const RunLink old(node.link[from]);
    const std::uint32_t count = node.points[into], more = node.points[from];
    if (count + more > run.room()) run = tree_.runs.grown(run, count + more);
    for (std::uint32_t i = 0; i < more; ++i) tree_.runs.set(run.slot(count + i), tree_.runs.get(old.slot(i)));
    tree_.runs.release(old);
    tree_.moved_points += count + more;
    Box box = node.box(into);
    box.include(node.box(from));
    node.set(into, {box, run.packed(), count + more});
  }

  void join_nodes(Node& node, std::size_t into, std::size_t from) {
    Node& target = tree_.at(node.link[into]);
    const Node& old = tree_.at(node.link[from]);
    for (std::size_t lane = 0; lane < old.count; ++lane) target.push_back(old.entry(lane));
    tree_.moved_links += old.count;
    tree_.release_node(node.link[from]);
    node.set_box(into, target.box());
  }

  Tree& tree_;
  const Region& region_;
  Leaves& leaves_;
  Gone& gone_;
  Around& around_;
  Box untold_;
};

}  // namespace chainslam::detail
