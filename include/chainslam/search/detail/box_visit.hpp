#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

#include "chainslam/search/detail/box_erase.hpp"
#include "chainslam/search/detail/box_tree.hpp"

namespace chainslam::detail {

/// Finds a point in a box for which `accept(slot)` holds. Returns its slot and fills the way to it; -1 if there is
/// none.
template <class Tree, class Accept>
[[nodiscard]] Index find_point(const Tree& tree, const typename Tree::Box& box, typename Tree::Path& path,
                               Accept&& accept) {
  if (tree.height == 0) return -1;
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
    const auto& node = tree.at(path.node[level]);
    if (level > 0) {
      path.node[--level] = node.link[lane];
      waiting[level] = tree.at(path.node[level]).touching(box);
      continue;
    }
    const RunLink run(node.link[lane]);
    for (std::uint32_t i = 0; i < node.points[lane]; ++i)
      if (accept(run.slot(i))) return run.slot(i);
  }
}

/// Calls `visit(slot, position)` for the points below a node that lie in a region.
template <class Tree, class Region, class Visit>
void visit_below(const Tree& tree, typename Tree::Link link, std::size_t level, const Region& region, Visit& visit) {
  const auto& node = tree.at(link);
  for (std::size_t lane = 0; lane < node.count; ++lane) {
    const Overlap overlap = region.overlap(wide_box(node.box(lane)));
    if (overlap == Overlap::outside) continue;
    if (level > 0) {
      visit_below(tree, node.link[lane], level - 1, region, visit);
      continue;
    }
    const RunLink run(node.link[lane]);
    for (std::uint32_t i = 0; i < node.points[lane]; ++i) {
      const auto p = tree.runs.position(run.slot(i));
      if (overlap == Overlap::inside || region.contains(p)) visit(run.slot(i), p);
    }
  }
}

/// The region that holds everything.
struct Everywhere {
  template <class Box>
  [[nodiscard]] Overlap overlap(const Box&) const {
    return Overlap::inside;
  }
  template <class Vector>
  [[nodiscard]] bool contains(const Vector&) const {
    return true;
  }
};

/// A region of which only its points know.
struct Somewhere {
  template <class Box>
  [[nodiscard]] Overlap overlap(const Box&) const {
    return Overlap::partly;
  }
};

/// One of the points at a place: no box lies inside.
template <class Scalar, int Dim>
struct PointRegion {
  Eigen::Matrix<Scalar, Dim, 1> p;

  [[nodiscard]] Overlap overlap(const Eigen::AlignedBox<double, Dim>& box) const {
    return box.contains(p.template cast<double>().eval()) ? Overlap::partly : Overlap::outside;
  }
};

}  // namespace chainslam::detail
