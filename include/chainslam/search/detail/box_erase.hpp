#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <utility>

#include "chainslam/search/detail/box_tree.hpp"
#include "chainslam/search/detail/region_lanes.hpp"
#include "chainslam/search/detail/regions.hpp"

namespace chainslam::detail {

/// Erases a region from a tree: what lies inside goes as whole subtrees, and only leaves on the rim are looked at point
/// by point. Small leaves and nodes left over join a sibling.
///
/// `leaving(run, count)` says which of a leaf's points go, by a mask of their lanes; `map.forget(p)` is told of the
/// points that go near the rim, all others are farther than `map.reach()` from what stays.
template <class Tree, class Region, class Leaving, class Map>
class BoxTreeEraser {
 public:
  using Scalar = typename Tree::Scalar;
  using Node = typename Tree::Node;
  using Link = typename Tree::Link;
  using Box = typename Tree::Box;

  BoxTreeEraser(Tree& tree, const Region& region, const Leaving& leaving, Map& map)
      : tree_(tree), region_(region), leaving_(leaving), map_(map), deep_(shrunk(region, map.reach())) {}

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

  /// Whether there were points of which the map was not told, and a box around them.
  [[nodiscard]] bool erased_untold() const { return untold_.low[0] <= untold_.high[0]; }
  [[nodiscard]] const Box& untold() const { return untold_; }

 private:
  static constexpr std::size_t small_leaf = 8, joined_leaf = 24, small_node = 3, joined_node = Node::width;

  void visit(Link link, std::size_t level) {
    Node& node = tree_.at(link);
    const LaneOverlap overlap = overlap_lanes(region_, node);
    const unsigned deep = overlap_lanes(deep_, node).inside;
    unsigned changed = 0;  // lanes that hold less than before
    for (unsigned lanes = overlap.inside | overlap.partly; lanes != 0;) {
      const auto lane = static_cast<std::size_t>(std::bit_width(lanes)) - 1;
      lanes ^= 1U << lane;
      if ((overlap.inside >> lane & 1U) != 0) {
        drop(node, lane, level, (deep >> lane & 1U) != 0);
      } else {
        const std::size_t before = tree_.size;
        if (level == 0 ? filter_leaf(node, lane) : filter_node(node, lane, level)) {
          if (tree_.size != before) changed |= 1U << lane;
          continue;
        }
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
    const std::uint32_t count = node.points[lane], leaving = leaving_(run, count);
    if (leaving == 0) return true;
    tell(run, node.box(lane), count, leaving);
    std::uint32_t kept = 0;
    Box box;
    for (std::uint32_t staying = first_lanes(count) & ~leaving; staying != 0; staying &= staying - 1) {
      const auto from = static_cast<std::uint32_t>(std::countr_zero(staying));
      const auto point = tree_.runs.get(run.slot(from));
      box.include(point.at);
      if (kept < from) tree_.runs.set(run.slot(kept), point);
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

  /// Tells of the points of a leaf that go, those in the lanes of a mask, near the rim.
  void tell(RunLink run, const Box& box, std::uint32_t count, std::uint32_t leaving) {
    const std::uint32_t told = leaving & ~contained_lanes(deep_, tree_.runs, run, count);
    if (told != leaving) untold_.include(box);
    for (std::uint32_t lanes = told; lanes != 0; lanes &= lanes - 1)
      map_.forget(tree_.runs.position(run.slot(static_cast<std::uint32_t>(std::countr_zero(lanes)))));
  }

  /// Frees all below a child that is erased as a whole, deep in the region or not.
  void drop(const Node& node, std::size_t lane, std::size_t level, bool deep) {
    const Link child = node.link[lane];
    if (deep) {
      untold_.include(node.box(lane));
      level == 0 ? free_leaf(child, node.points[lane]) : free_node(child, level - 1);
    } else if (level == 0) {
      tell(RunLink(child), node.box(lane), node.points[lane], first_lanes(node.points[lane]));
      free_leaf(child, node.points[lane]);
    } else {
      const Node& below = tree_.at(child);
      const unsigned deep_below = overlap_lanes(deep_, below).inside;
      for (std::size_t i = 0; i < below.count; ++i) drop(below, i, level - 1, (deep_below >> i & 1U) != 0);
      tree_.release_node(child);
    }
  }

  void free_leaf(Link leaf, std::uint32_t points) {
    tree_.runs.release(RunLink(leaf));
    tree_.size -= points;
  }

  /// Frees a node and all below it, of which only links and numbers of points are read.
  void free_node(Link link, std::size_t level) {
    const Node& node = tree_.at(link);
    if (level > 0)
      for (std::size_t lane = 0; lane < node.count; ++lane) __builtin_prefetch(&tree_.at(node.link[lane]).link);
    for (std::size_t lane = 0; lane < node.count; ++lane)
      level == 0 ? free_leaf(node.link[lane], node.points[lane]) : free_node(node.link[lane], level - 1);
    tree_.release_node(link);
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
  const Leaving& leaving_;
  Map& map_;
  decltype(shrunk(std::declval<const Region&>(), 0.0)) deep_;  ///< of what lies in it the map is not told
  Box untold_;
};

}  // namespace chainslam::detail
