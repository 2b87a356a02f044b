#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "chainslam/search/detail/box_build.hpp"
#include "chainslam/search/detail/box_cut.hpp"
#include "chainslam/search/detail/box_split.hpp"
#include "chainslam/search/detail/box_tree.hpp"

namespace chainslam::detail {

/// Puts points into a tree. A full leaf is split in two and the second half handed to its node; so is a full node,
/// which is first sorted anew, points and all, where there are few enough below it: boxes that grew one by one overlap,
/// and searches pay for that. The depth is bounded for points in any order.
template <class Tree>
class BoxTreeInserter {
 public:
  using Scalar = typename Tree::Scalar;
  using Point = typename Tree::Point;
  using Node = typename Tree::Node;
  using Entry = typename Tree::Entry;
  using Box = typename Tree::Box;
  using Link = typename Tree::Link;
  using Path = typename Tree::Path;

  explicit BoxTreeInserter(Tree& tree) : tree_(tree) {}

  void insert(const Point& point) {
    ++tree_.size;
    if (tree_.height == 0) return start(point);
    Path path;
    Link link = tree_.root;
    for (std::size_t level = tree_.height; level-- > 0;) {
      Node& node = tree_.at(link);
      const std::size_t lane = lane_of(node.keys(point.at.data()).smallest());
      node.include(lane, point.at);
      path.node[level] = link;
      path.lane[level] = lane;
      link = node.link[lane];
    }
    add_to_leaf(path, point);
  }

  /// Puts a point in the place of the one at the path's end, whose leaf it then shares.
  void replace(const Path& path, Index slot, const Point& point) {
    const std::array<Scalar, Tree::Dim> old = tree_.runs.get(slot).at;
    tree_.runs.set(slot, point);
    ++tree_.moved_points;
    for (std::size_t level = 0; level < tree_.height; ++level) {
      Node& node = tree_.at(path.node[level]);
      const std::size_t lane = path.lane[level];
      node.include(lane, point.at);
      if (!node.box(lane).touches_rim(old)) continue;
      const RunLink run(node.link[lane]);
      node.set_box(lane, level > 0 ? tree_.at(path.node[level - 1]).box() : tree_.box_of(run, node.points[lane]));
    }
  }

 private:
  void start(const Point& point) {
    tree_.root = tree_.take_node();
    tree_.height = 1;
    tree_.at(tree_.root).push_back(tree_.leaf_entry(&point, 1));
  }

  void add_to_leaf(const Path& path, const Point& point) {
    Node& node = tree_.at(path.node[0]);
    const std::size_t lane = path.lane[0];
    RunLink run(node.link[lane]);
    const std::uint32_t count = node.points[lane];
    if (count == RunLink::max_points) return split_leaf(path, point);
    if (count == run.room()) {
      run = tree_.runs.grown(run, count + 1);
      node.link[lane] = run.packed();
      tree_.moved_points += count;
    }
    tree_.runs.set(run.slot(count), point);
    ++node.points[lane];
    ++tree_.moved_points;
  }

  void split_leaf(const Path& path, const Point& point) {
    constexpr std::size_t total = RunLink::max_points + 1;
    std::array<Point, total> points, scratch;
    const RunLink run(tree_.at(path.node[0]).link[path.lane[0]]);
    for (std::uint32_t lane = 0; lane < RunLink::max_points; ++lane) points[lane] = tree_.runs.get(run.slot(lane));
    points.back() = point;
    tree_.runs.release(run);
    const std::size_t below =
        split_points<Point>({points.data(), total}, {scratch.data(), total}, total / 4, total - total / 4).below;
    tree_.at(path.node[0]).set(path.lane[0], tree_.leaf_entry(points.data(), below));
    add_child(path, tree_.leaf_entry(points.data() + below, total - below));
  }

  /// Gives the node at the path's level 0 one more child, splitting the nodes on the path that have no room.
  void add_child(const Path& path, Entry more) {
    for (std::size_t level = 0; level < tree_.height; ++level) {
      Node& node = tree_.at(path.node[level]);
      ++tree_.moved_links;
      if (node.count < Node::width) return node.push_back(more);
      const auto halves = split_node(path.node[level], more, level);
      if (level + 1 < tree_.height)
        tree_.at(path.node[level + 1]).set(path.lane[level + 1], halves[0]);
      else
        tree_.root = halves[0].link;
      if (level + 1 == tree_.height) return grow_root(halves);
      more = halves[1];
    }
  }

  /// Makes two nodes of a full one and one more child.
  [[nodiscard]] std::array<Entry, 2> split_node(Link link, const Entry& more, std::size_t level) {
    const std::size_t points =
        tree_.count_below(link, level, tree_.budget) + tree_.count_below(more, level, tree_.budget);
    if (points <= tree_.budget) return sort_anew(link, more, level, points);
    typename BoxTreeCutter<Tree>::Children children;
    for (std::size_t lane = 0; lane < Node::width; ++lane) children[lane] = tree_.at(link).entry(lane);
    children.back() = more;
    const Link second = tree_.take_node();
    tree_.at(link).clear();
    BoxTreeCutter<Tree> cutter(tree_);
    if (const auto plane = cutter.find_plane(children, level)) {
      cutter.part(children.data(), children.size(), level, *plane, link, second);
    } else {
      const std::size_t first = split_entries(children);
      for (std::size_t i = 0; i < children.size(); ++i) tree_.at(i < first ? link : second).push_back(children[i]);
      tree_.moved_links += children.size();
    }
    return {tree_.node_entry(link), tree_.node_entry(second)};
  }

  [[nodiscard]] std::array<Entry, 2> sort_anew(Link link, const Entry& more, std::size_t level, std::size_t count) {
    std::vector<Point> points(count);
    Point* next = points.data();
    const Node& node = tree_.at(link);
    for (std::size_t lane = 0; lane < node.count; ++lane) next = tree_.take_points(node.entry(lane), level, next);
    tree_.take_points(more, level, next);
    tree_.release_node(link);
    return BoxTreeBuilder<Tree>::two_nodes(tree_, {points.data(), count}, level);
  }

  void grow_root(const std::array<Entry, 2>& halves) {
    if (tree_.height == Tree::max_height) return build_anew(halves);
    tree_.root = tree_.take_node();
    ++tree_.height;
    for (const Entry& half : halves) tree_.at(tree_.root).push_back(half);
    tree_.moved_links += 2;
  }

  void build_anew(const std::array<Entry, 2>& halves) {
    std::vector<Point> points(tree_.size);
    Point* next = points.data();
    for (const Entry& half : halves) next = tree_.take_points(half, tree_.height, next);
    BoxTreeBuilder<Tree>::build(tree_, {points.data(), points.size()});
  }

  Tree& tree_;
};

}  // namespace chainslam::detail
