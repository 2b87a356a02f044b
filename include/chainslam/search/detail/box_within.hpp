#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

#include "chainslam/search/detail/box_tree.hpp"
#include "chainslam/search/detail/radius_list.hpp"

namespace chainslam::detail {

/// Lists the points of a leaf that are within the radius.
template <class Scalar, int Dim>
void list_run(const PointGroup<Scalar, Dim>* groups, RunLink run, const std::array<Pack<Scalar>, Dim>& query,
              RadiusList<Scalar>& found) {
  found.make_room(RunLink::max_points);
  for (std::uint32_t g = 0; g < run.groups(); ++g) {
    Pack<Scalar> sum = Pack<Scalar>::all(0);
    for (std::size_t axis = 0; axis < static_cast<std::size_t>(Dim); ++axis) {
      const Pack<Scalar> d = Pack<Scalar>::load(groups[g].at[axis].data()) - query[axis];
      sum = axis == 0 ? d * d : sum + d * d;
    }
    found.offer_lanes(run.slot(g * static_cast<std::uint32_t>(pack_width)), sum);
  }
}

/// Lists every point within the radius. The radius does not shrink as points are found, so all children of a node that
/// it reaches are told at once, and in which order they come does not matter.
template <class Tree>
void search_within(const Tree& tree, const typename Tree::Scalar* query, RadiusList<typename Tree::Scalar>& found) {
  using Scalar = typename Tree::Scalar;
  struct Waiting {
    typename Tree::Link link;
    std::uint32_t level;
  };
  if (tree.height == 0) return;
  std::array<Pack<Scalar>, Tree::Dim> everywhere;
  for (std::size_t axis = 0; axis < everywhere.size(); ++axis) everywhere[axis] = Pack<Scalar>::all(query[axis]);
  std::array<Waiting, pack_width * Tree::max_height> waiting;
  std::size_t count = 0;
  waiting[count++] = {tree.root, static_cast<std::uint32_t>(tree.height - 1)};
  while (count > 0) {
    const Waiting next = waiting[--count];
    const typename Tree::Node& node = tree.at(next.link);
    unsigned near = node.squared_distances(query).below(found.bound());
    if (next.level > 0) {
      for (; near != 0; near &= near - 1)
        waiting[count++] = {node.link[static_cast<std::size_t>(std::countr_zero(near))], next.level - 1};
    } else {
      for (; near != 0; near &= near - 1) {
        const RunLink run(node.link[static_cast<std::size_t>(std::countr_zero(near))]);
        list_run<Scalar, Tree::Dim>(tree.runs.groups(run), run, everywhere, found);
      }
    }
  }
}

}  // namespace chainslam::detail
