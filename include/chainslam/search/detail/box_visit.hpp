#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

#include "chainslam/search/detail/box_erase.hpp"
#include "chainslam/search/detail/box_tree.hpp"

namespace chainslam::detail {

/// Bit i is set where the point in lane i of a leaf lies in a box.
template <class Scalar, int Dim>
[[nodiscard]] std::uint32_t lanes_inside(const PointGroup<Scalar, Dim>* groups, RunLink run,
                                         const Bounds<Scalar, Dim>& box) {
  std::uint32_t mask = 0;
  for (std::uint32_t g = 0; g < run.groups(); ++g) {
    Pack<Scalar> outside = Pack<Scalar>::all(0);
    for (std::size_t axis = 0; axis < static_cast<std::size_t>(Dim); ++axis) {
      const Pack<Scalar> p = Pack<Scalar>::load(groups[g].at[axis].data());
      outside = max(outside, max(Pack<Scalar>::all(box.low[axis]) - p, p - Pack<Scalar>::all(box.high[axis])));
    }
    mask |= outside.at_most(0) << (pack_width * g);
  }
  return mask;
}

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
    const std::uint32_t link = tree.at(path.node[level]).link[lane];
    if (level > 0) {
      path.node[--level] = link;
      waiting[level] = tree.at(link).touching(box);
      continue;
    }
    const RunLink run(link);
    for (std::uint32_t near = lanes_inside(tree.runs.groups(run), run, box); near != 0; near &= near - 1) {
      const Index slot = run.slot(static_cast<std::uint32_t>(std::countr_zero(near)));
      if (accept(slot)) return slot;
    }
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
