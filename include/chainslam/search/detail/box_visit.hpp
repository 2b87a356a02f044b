#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

#include "chainslam/search/detail/box_tree.hpp"
#include "chainslam/search/detail/region_lanes.hpp"

namespace chainslam::detail {

/// Finds a point in a box for which `accept(slot)` holds. Returns its slot and fills the way to it; -1 if there is
/// none.
template <class Tree, class Accept>
[[nodiscard]] Index find_point(const Tree& tree, const typename Tree::Box& box, typename Tree::Path& path,
                               Accept&& accept) {
  if (tree.height == 0) return -1;
  const auto region = region_of(box);
  std::array<unsigned, Tree::max_height> waiting;
  std::size_t level = tree.height - 1;
  path.node[level] = tree.root;
  waiting[level] = tree.at(tree.root).touching(box);
  for (;;) {
    if (waiting[level] == 0) {
      if (++level == tree.height) return -1;
      continue;
    }
    const auto lane = static_cast<std::size_t>(std::countr_zero(waiting[level]));
    waiting[level] &= waiting[level] - 1;
    path.lane[level] = lane;
    const std::uint32_t link = tree.at(path.node[level]).link[lane];
    if (level > 0) {
      path.node[--level] = link;
      waiting[level] = tree.at(link).touching(box);
      continue;
    }
    const RunLink run(link);
    for (std::uint32_t near = contained_lanes(region, tree.runs, run, tree.at(path.node[0]).points[lane]); near != 0;
         near &= near - 1) {
      const Index slot = run.slot(static_cast<std::uint32_t>(std::countr_zero(near)));
      if (accept(slot)) return slot;
    }
  }
}

/// Calls `visit(slot, position)` for the points below a node that lie in a region.
template <class Tree, class Region, class Visit>
void visit_below(const Tree& tree, typename Tree::Link link, std::size_t level, const Region& region, Visit& visit) {
  const auto& node = tree.at(link);
  const LaneOverlap overlap = overlap_lanes(region, node);
  for (unsigned lanes = overlap.inside | overlap.partly; lanes != 0; lanes &= lanes - 1) {
    const auto lane = static_cast<std::size_t>(std::countr_zero(lanes));
    if (level > 0) {
      visit_below(tree, node.link[lane], level - 1, region, visit);
      continue;
    }
    const RunLink run(node.link[lane]);
    const std::uint32_t all = first_lanes(node.points[lane]);
    const bool whole = (overlap.inside >> lane & 1U) != 0;
    for (std::uint32_t in = whole ? all : contained_lanes(region, tree.runs, run, node.points[lane]); in != 0;
         in &= in - 1) {
      const Index slot = run.slot(static_cast<std::uint32_t>(std::countr_zero(in)));
      visit(slot, tree.runs.position(slot));
    }
  }
}

}  // namespace chainslam::detail
