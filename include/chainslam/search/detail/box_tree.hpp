#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/search/detail/box_node.hpp"
#include "chainslam/search/detail/box_split.hpp"
#include "chainslam/search/detail/growing_array.hpp"
#include "chainslam/search/detail/point_runs.hpp"

namespace chainslam::detail {

/// A balanced tree of boxes: nodes of up to eight children, leaves of up to 32 points, all leaves equally deep, as in a
/// B-tree (Bayer and McCreight 1972) over space (Guttman 1984). A full leaf or node is split in two, and the second
/// half handed to its parent: a point that comes in moves at most the 32 of one leaf and nine children a level. The
/// depth is bounded by that, whatever the points and their order.
///
/// Level 0 holds the nodes whose children are leaves; the root is at level `height - 1`.
template <class Scalar_, int Dim_, class Payload_>
struct BoxTree {
  using Scalar = Scalar_;
  using Payload = Payload_;
  static constexpr int Dim = Dim_;
  using Node = BoxNode<Scalar, Dim>;
  using Entry = BoxEntry<Scalar, Dim>;
  using Box = Bounds<Scalar, Dim>;
  using Runs = PointRuns<Scalar, Dim, Payload>;
  using Point = typename Runs::Point;
  using Link = std::uint32_t;

  /// Each level has at least a third more children than the one above: 3^32 exceeds every count.
  static constexpr std::size_t max_height = 32;

  /// A child and the way to it: node and lane at each level.
  struct Path {
    std::array<Link, max_height> node;
    std::array<std::size_t, max_height> lane;
  };

  [[nodiscard]] const Node& at(Link link) const { return nodes[link]; }
  [[nodiscard]] Node& at(Link link) { return nodes[link]; }

  /// A node without children. References to nodes are good until then.
  [[nodiscard]] Link take_node() {
    Link link;
    if (free_nodes.empty()) {
      link = static_cast<Link>(nodes.size());
      nodes.resize(nodes.size() + 1);
    } else {
      link = free_nodes.back();
      free_nodes.pop_back();
    }
    nodes[link].clear();
    return link;
  }
  void release_node(Link link) { free_nodes.push_back(link); }

  void insert(const Point& point) {
    ++size;
    if (height == 0) return start(point);
    Path path;
    Link link = root;
    for (std::size_t level = height; level-- > 0;) {
      Node& node = at(link);
      const Pack<Scalar> distances = node.squared_distances(point.at.data());
      const std::size_t lane = distances.find(distances.smallest());
      node.include(lane, point.at);
      path.node[level] = link;
      path.lane[level] = lane;
      link = node.link[lane];
    }
    add_to_leaf(path, point);
  }

  /// Puts a point in the place of the one at the path's end, whose leaf it then shares.
  void replace(const Path& path, Index slot, const Point& point) {
    runs.set(slot, point);
    ++moved_points;
    const Node& last = at(path.node[0]);
    const std::size_t lane = path.lane[0];
    Box box;
    for (std::uint32_t i = 0; i < last.points[lane]; ++i) box.include(runs.get(RunLink(last.link[lane]).slot(i)).at);
    at(path.node[0]).set_box(lane, box);
    for (std::size_t level = 1; level < height; ++level)
      at(path.node[level]).set_box(path.lane[level], at(path.node[level - 1]).box());
  }

  [[nodiscard]] Entry leaf_entry(std::span<const Point> points) {
    Entry entry{{}, runs.store(points).packed(), static_cast<std::uint32_t>(points.size())};
    for (const Point& p : points) entry.box.include(p.at);
    moved_points += points.size();
    return entry;
  }

  [[nodiscard]] std::size_t memory() const {
    return nodes.memory() + free_nodes.capacity() * sizeof(Link) + runs.memory();
  }

  Runs runs;
  GrowingArray<Node> nodes;
  std::vector<Link> free_nodes;
  Link root = 0;
  std::size_t height = 0;  ///< levels of nodes; 0 if there is no point
  std::size_t size = 0;
  std::size_t moved_points = 0;  ///< work done since it was last set to 0: points written,
  std::size_t moved_links = 0;   ///< and children of nodes written

 private:
  void start(const Point& point) {
    root = take_node();
    height = 1;
    at(root).push_back(leaf_entry(std::span(&point, 1)));
  }

  void add_to_leaf(const Path& path, const Point& point) {
    Node& node = at(path.node[0]);
    const std::size_t lane = path.lane[0];
    RunLink run(node.link[lane]);
    const std::uint32_t count = node.points[lane];
    if (count == RunLink::max_points) return split_leaf(path, point);
    if (count == run.room()) {
      run = runs.grown(run, count + 1);
      node.link[lane] = run.packed();
      moved_points += count;
    }
    runs.set(run.slot(count), point);
    ++node.points[lane];
    ++moved_points;
  }

  void split_leaf(const Path& path, const Point& point) {
    constexpr std::size_t total = RunLink::max_points + 1;
    std::array<Point, total> points;
    const RunLink run(at(path.node[0]).link[path.lane[0]]);
    for (std::uint32_t lane = 0; lane < RunLink::max_points; ++lane) points[lane] = runs.get(run.slot(lane));
    points.back() = point;
    runs.release(run);
    const std::size_t below = split_points(std::span<Point>(points), total / 4, total - total / 4);
    at(path.node[0]).set(path.lane[0], leaf_entry(std::span<const Point>(points).first(below)));
    add_child(path, leaf_entry(std::span<const Point>(points).subspan(below)));
  }

  /// Gives the node at the path's level 0 one more child, splitting the nodes on the path that have no room.
  void add_child(const Path& path, Entry entry) {
    for (std::size_t level = 0;; ++level) {
      if (level == height) return grow_root(entry);
      Node& node = at(path.node[level]);
      ++moved_links;
      if (node.count < Node::width) return node.push_back(entry);
      entry = split_node(path.node[level], entry);
      if (level + 1 < height) at(path.node[level + 1]).set_box(path.lane[level + 1], at(path.node[level]).box());
    }
  }

  /// Splits a full node with one more child in two. Returns the entry of the second.
  [[nodiscard]] Entry split_node(Link link, const Entry& more) {
    std::array<Entry, Node::width + 1> entries;
    for (std::size_t lane = 0; lane < Node::width; ++lane) entries[lane] = at(link).entry(lane);
    entries.back() = more;
    const std::size_t first = split_entries(entries);
    const Link second = take_node();
    at(link).clear();
    for (std::size_t i = 0; i < entries.size(); ++i) at(i < first ? link : second).push_back(entries[i]);
    moved_links += entries.size();
    return {at(second).box(), second, 0};
  }

  void grow_root(const Entry& entry) {
    const Link old = root;
    root = take_node();
    ++height;
    at(root).push_back({at(old).box(), old, 0});
    at(root).push_back(entry);
    moved_links += 2;
  }
};

}  // namespace chainslam::detail
