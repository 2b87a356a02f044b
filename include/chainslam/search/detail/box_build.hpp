#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <span>
#include <vector>

#include "chainslam/search/detail/box_split.hpp"
#include "chainslam/search/detail/box_tree.hpp"

namespace chainslam::detail {

/// Fills an empty tree with many points at once: splits them as a k-d tree does, three splits a node.
template <class Tree>
class BoxTreeBuilder {
 public:
  using Point = typename Tree::Point;
  using Entry = typename Tree::Entry;
  using Node = typename Tree::Node;

  /// @param points  are reordered.
  static void build(Tree& tree, std::span<Point> points) {
    if (points.empty()) return;
    BoxTreeBuilder builder(tree, points.size());
    std::size_t height = 1;
    while (points.size() > usual_leaf * power(height)) ++height;
    tree.root = builder.make_node(points, height - 1).link;
    tree.height = height;
    tree.size = points.size();
  }

  /// Two nodes at a level that together hold these points, more than one node at the level below can.
  [[nodiscard]] static std::array<Entry, 2> two_nodes(Tree& tree, std::span<Point> points, std::size_t level) {
    BoxTreeBuilder builder(tree, points.size());
    const std::size_t n = points.size(), most = room(level + 1), quarter = n / 4;
    const std::size_t low = std::max(quarter, n - std::min(n - 1, most));
    const std::size_t below = split_points(points, builder.scratch(), low, n - low).below;
    return {builder.make_node(points.first(below), level), builder.make_node(points.subspan(below), level)};
  }

 private:
  /// The height is chosen for this many points a leaf, so that splits need not be even.
  static constexpr std::size_t usual_leaf = 20;
  /// The most below a child of a node, for each leaf that it can have.
  static constexpr std::size_t full_leaf = 26;

  BoxTreeBuilder(Tree& tree, std::size_t points) : tree_(tree), scratch_(points) {}

  [[nodiscard]] static constexpr std::size_t power(std::size_t exponent) { return std::size_t{1} << (3 * exponent); }

  /// The most points in a child of a node at a level.
  [[nodiscard]] static std::size_t room(std::size_t level) {
    return level == 0 ? RunLink::max_points : full_leaf * power(level);
  }

  [[nodiscard]] Entry make_node(std::span<Point> points, std::size_t level) {
    const auto link = tree_.take_node();
    add_children(link, points, level, Node::width);
    return tree_.node_entry(link);
  }

  /// Divides the points among at most `children` new children of a node.
  void add_children(typename Tree::Link node, std::span<Point> points, std::size_t level, std::size_t children) {
    const std::size_t n = points.size(), most = room(level);
    if (n <= most) {
      const Entry entry = level == 0 ? tree_.leaf_entry(points.data(), n) : make_node(points, level - 1);
      tree_.at(node).push_back(entry);
      return;
    }
    const auto at_least = [&](std::size_t share) { return (share + most - 1) / most; };
    // Each side gets a quarter of the points or more, and no more than its children can hold.
    std::size_t low = std::max(n / 4, n > (children - 1) * most ? n - (children - 1) * most : 1);
    low = std::max<std::size_t>(low, 1);
    auto split = split_points(points, scratch(), low, n - low);
    const std::size_t below = split.below;
    std::size_t first = std::clamp<std::size_t>((children * below + n / 2) / n, 1, children - 1);
    first = std::max(first, std::min(at_least(below), children - 1));
    if (at_least(n - below) > children - first) first = children - std::min(at_least(n - below), children - 1);
    if (below > first * most || n - below > (children - first) * most) {
      const std::size_t allowed = std::clamp(below, n - std::min(n, (children - first) * most), first * most);
      move_split(split, points, scratch(), allowed);
    }
    add_children(node, points.first(split.below), level, first);
    add_children(node, points.subspan(split.below), level, children - first);
  }

  [[nodiscard]] std::span<Point> scratch() { return {scratch_.data(), scratch_.size()}; }

  Tree& tree_;
  std::vector<Point> scratch_;
};

}  // namespace chainslam::detail
