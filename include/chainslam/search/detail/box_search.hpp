#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

#include "chainslam/search/detail/box_tree.hpp"

namespace chainslam::detail {

/// Offers the points of a leaf that are nearer than the collector's bound.
template <class Scalar, int Dim, class Collector>
void scan_run(const PointGroup<Scalar, Dim>* groups, RunLink run, const Scalar* query, Collector& found) {
  for (std::uint32_t g = 0; g < run.groups(); ++g) {
    Pack<Scalar> sum = Pack<Scalar>::all(0);
    for (std::size_t axis = 0; axis < Dim; ++axis) {
      const Pack<Scalar> d = Pack<Scalar>::load(groups[g].at[axis].data()) - Pack<Scalar>::all(query[axis]);
      sum = axis == 0 ? d * d : sum + d * d;
    }
    unsigned near = sum.below(found.bound());
    if (near == 0) continue;
    alignas(32) std::array<Scalar, pack_width> distances;
    sum.store(distances.data());
    const Index first = run.slot(g * static_cast<std::uint32_t>(pack_width));
    for (; near != 0; near &= near - 1) {
      const int lane = std::countr_zero(near);
      const Scalar distance = distances[static_cast<std::size_t>(lane)];
      if (distance < found.bound()) found.offer(first + lane, distance);  // the bound may have come nearer
    }
  }
}

/// Offers every point nearer than the collector's bound, the nearest box first. Where the bound only cuts off the end,
/// the order in which points are offered does not depend on it: a search that starts with a nearer bound ends alike.
template <class Tree, class Collector>
void search_nearest(const Tree& tree, const typename Tree::Scalar* query, Collector& found) {
  using Scalar = typename Tree::Scalar;
  struct alignas(32) Frame {
    std::array<Scalar, pack_width> distances;
    const typename Tree::Node* node;
  };
  if (tree.height == 0) return;
  std::array<Frame, Tree::max_height> frames;
  const auto enter = [&](std::size_t level, typename Tree::Link link) {
    frames[level].node = &tree.at(link);
    frames[level].node->squared_distances(query).store(frames[level].distances.data());
  };
  std::size_t level = tree.height - 1;
  enter(level, tree.root);
  for (;;) {
    Frame& frame = frames[level];
    const Pack<Scalar> distances = Pack<Scalar>::load(frame.distances.data());
    const Scalar nearest = distances.smallest();
    if (!(nearest < found.bound())) {
      if (++level == tree.height) return;
      continue;
    }
    const unsigned lane = distances.find(nearest);
    frame.distances[lane] = std::numeric_limits<Scalar>::infinity();
    const std::uint32_t link = frame.node->link[lane];
    if (level == 0) {
      const RunLink run(link);
      scan_run<Scalar, Tree::Dim>(tree.runs.groups(run), run, query, found);
    } else {
      enter(--level, link);
    }
  }
}

}  // namespace chainslam::detail
