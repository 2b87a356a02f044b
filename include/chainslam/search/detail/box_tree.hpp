#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "chainslam/search/detail/box_node.hpp"
#include "chainslam/search/detail/growing_array.hpp"
#include "chainslam/search/detail/point_runs.hpp"

namespace chainslam::detail {

/// A balanced tree of boxes: nodes of up to eight children, leaves of up to 32 points, all leaves equally deep, as in a
/// B-tree (Bayer and McCreight 1972) over space (Guttman 1984).
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

  /// A level takes twice the points of the one below, or more: beyond this the tree is built anew.
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

  [[nodiscard]] Box box_of(RunLink run, std::uint32_t points) const {
    Box box;
    for (std::uint32_t lane = 0; lane < points; ++lane) box.include(runs.get(run.slot(lane)).at);
    return box;
  }
  [[nodiscard]] Entry leaf_entry(const Point* points, std::size_t count) {
    Entry entry{{}, runs.store(points, count).packed(), static_cast<std::uint32_t>(count)};
    for (std::size_t i = 0; i < count; ++i) entry.box.include(points[i].at);
    moved_points += count;
    return entry;
  }

  [[nodiscard]] Entry node_entry(Link link) const { return {at(link).box(), link, 0}; }

  /// Points below a child of a node at a level; stops counting beyond a limit.
  [[nodiscard]] std::size_t count_below(const Entry& child, std::size_t level, std::size_t limit) const {
    return level == 0 ? child.points : count_below(child.link, level - 1, limit);
  }
  /// Points below a node. Not inlined into itself: a compiler would unfold several levels.
  [[nodiscard, gnu::noinline]] std::size_t count_below(Link link, std::size_t level, std::size_t limit) const {
    const Node& node = at(link);
    std::size_t count = 0;
    for (std::size_t lane = 0; lane < node.count && count <= limit; ++lane)
      count += level == 0 ? node.points[lane] : count_below(node.link[lane], level - 1, limit - count);
    return count;
  }
  /// Writes the points below a child of a node at a level to `points` and behind it, and frees what held them. Returns
  /// where the next goes.
  [[gnu::noinline]] Point* take_points(const Entry& child, std::size_t level, Point* points) {
    if (level == 0) {
      const RunLink run(child.link);
      for (std::uint32_t lane = 0; lane < child.points; ++lane) *points++ = runs.get(run.slot(lane));
      runs.release(run);
      return points;
    }
    const Node& node = at(child.link);
    for (std::size_t lane = 0; lane < node.count; ++lane) points = take_points(node.entry(lane), level - 1, points);
    release_node(child.link);
    return points;
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
  std::size_t budget = 5000;     ///< points that one insertion may sort anew
  std::size_t moved_points = 0;  ///< work done since it was last set to 0: points written,
  std::size_t moved_links = 0;   ///< and children of nodes written
};

}  // namespace chainslam::detail
