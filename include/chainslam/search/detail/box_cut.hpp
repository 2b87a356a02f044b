#pragma once

#include <array>
#include <cstddef>
#include <optional>

#include "chainslam/search/detail/box_split.hpp"
#include "chainslam/search/detail/box_tree.hpp"

namespace chainslam::detail {

/// A plane across an axis. Points at it lie below.
template <class Scalar>
struct Plane {
  std::size_t axis;
  Scalar at;

  template <class Box>
  [[nodiscard]] bool above_all(const Box& box) const {
    return box.high[axis] <= at;
  }
  template <class Box>
  [[nodiscard]] bool below_all(const Box& box) const {
    return box.low[axis] > at;
  }
  template <class Box>
  [[nodiscard]] bool crosses(const Box& box) const {
    return !above_all(box) && !below_all(box);
  }
};

/// Parts the children of a node by a plane, so that the boxes of the halves do not overlap: what the plane crosses is
/// cut, down to the leaves (Robinson 1981, K-D-B-tree). Only a surface's worth of points is moved.
template <class Tree>
class BoxTreeCutter {
 public:
  using Scalar = typename Tree::Scalar;
  using Point = typename Tree::Point;
  using Node = typename Tree::Node;
  using Entry = typename Tree::Entry;
  using Link = typename Tree::Link;
  using Children = std::array<Entry, Node::width + 1>;

  explicit BoxTreeCutter(Tree& tree) : tree_(tree) {}

  /// A plane that parts the children of a node at a level evenly enough and crosses few: nothing if there is none, or
  /// if that would move too many points.
  [[nodiscard]] std::optional<Plane<Scalar>> find_plane(const Children& children, std::size_t level) const {
    std::optional<Plane<Scalar>> best;
    std::size_t best_cost = most_children * 2;
    for (std::size_t axis = 0; axis < static_cast<std::size_t>(Tree::Dim); ++axis) {
      for (const Entry& child : children) {
        const Plane<Scalar> plane{axis, child.box.high[axis]};
        std::size_t below = 0, above = 0;
        for (const Entry& other : children) {
          below += plane.below_all(other.box) ? 0 : 1;
          above += plane.above_all(other.box) ? 0 : 1;
        }
        if (below > most_children || above > most_children) continue;
        const std::size_t crossed = below + above - children.size();
        const std::size_t cost = 2 * crossed + (below > above ? below - above : above - below);
        if (cost >= best_cost) continue;
        best_cost = cost;
        best = plane;
      }
    }
    if (!best) return best;
    std::size_t crossed = 0;
    for (const Entry& child : children) count_crossed(child, level, *best, crossed);
    return crossed <= tree_.budget ? best : std::nullopt;
  }

  /// Parts the children between two nodes.
  void part(const Entry* children, std::size_t count, std::size_t level, const Plane<Scalar>& plane, Link below,
            Link above) {
    for (std::size_t i = 0; i < count; ++i) {
      const Entry& child = children[i];
      if (plane.above_all(child.box)) {
        tree_.at(below).push_back(child);
      } else if (plane.below_all(child.box)) {
        tree_.at(above).push_back(child);
      } else {
        const auto halves = level == 0 ? cut_leaf(child, plane) : cut_node(child, level, plane);
        tree_.at(below).push_back(halves[0]);
        tree_.at(above).push_back(halves[1]);
      }
    }
    tree_.moved_links += count;
  }

 private:
  /// Leaves room for two more, so that a node that has been cut is not full again at once.
  static constexpr std::size_t most_children = Node::width - 1;

  /// Adds the points in leaves that the plane crosses; stops counting beyond the budget.
  [[gnu::noinline]] void count_crossed(const Entry& child, std::size_t level, const Plane<Scalar>& plane,
                                       std::size_t& count) const {
    if (count > tree_.budget || !plane.crosses(child.box)) return;
    if (level == 0) {
      count += child.points;
      return;
    }
    const Node& node = tree_.at(child.link);
    for (std::size_t lane = 0; lane < node.count; ++lane) count_crossed(node.entry(lane), level - 1, plane, count);
  }

  [[nodiscard]] std::array<Entry, 2> cut_leaf(const Entry& leaf, const Plane<Scalar>& plane) {
    std::array<std::array<Point, RunLink::max_points>, 2> sides;
    std::array<std::size_t, 2> counts{};
    const RunLink run(leaf.link);
    for (std::uint32_t lane = 0; lane < leaf.points; ++lane) {
      const Point point = tree_.runs.get(run.slot(lane));
      const std::size_t side = point.at[plane.axis] <= plane.at ? 0 : 1;
      sides[side][counts[side]++] = point;
    }
    tree_.runs.release(run);
    return {tree_.leaf_entry(sides[0].data(), counts[0]), tree_.leaf_entry(sides[1].data(), counts[1])};
  }

  [[nodiscard]] std::array<Entry, 2> cut_node(const Entry& child, std::size_t level, const Plane<Scalar>& plane) {
    std::array<Entry, Node::width> children;
    const std::size_t count = tree_.at(child.link).count;
    for (std::size_t lane = 0; lane < count; ++lane) children[lane] = tree_.at(child.link).entry(lane);
    tree_.at(child.link).clear();
    const Link above = tree_.take_node();
    part(children.data(), count, level - 1, plane, child.link, above);
    return {tree_.node_entry(child.link), tree_.node_entry(above)};
  }

  Tree& tree_;
};

}  // namespace chainslam::detail
