#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <type_traits>

#include "chainslam/search/detail/box_tree.hpp"
#include "chainslam/search/detail/box_within.hpp"
#include "chainslam/search/detail/nearest_list.hpp"

namespace chainslam::detail {

/// A run's squared distances from a query, and which of them are below a bound.
template <class Scalar>
class RunDistances {
 public:
  template <int Dim>
  RunDistances(const PointGroup<Scalar, Dim>* groups, std::size_t count, const Scalar* query) : groups_(count) {
    for (std::size_t g = 0; g < count; ++g) {
      Pack<Scalar> sum = Pack<Scalar>::all(0);
      for (std::size_t axis = 0; axis < static_cast<std::size_t>(Dim); ++axis) {
        const Pack<Scalar> d = Pack<Scalar>::load(groups[g].at[axis].data()) - Pack<Scalar>::all(query[axis]);
        sum = axis == 0 ? d * d : sum + d * d;
      }
      sum.store(&distances_[pack_width * g]);
    }
  }

  [[nodiscard]] Scalar operator[](std::size_t lane) const { return distances_[lane]; }
  [[nodiscard]] std::uint32_t below(Scalar bound) const {
    std::uint32_t mask = 0;
    for (std::size_t g = 0; g < groups_; ++g) mask |= group(g).below(bound) << (pack_width * g);
    return mask;
  }
  /// A bound above the k-th smallest, not far, of a run whose first group is full: each lane of the groups gives its
  /// smallest.
  [[nodiscard]] Scalar bound_for(int k) const {
    Pack<Scalar> nearest = group(0);
    for (std::size_t g = 1; g < groups_; ++g) nearest = min(nearest, group(g));
    return next_above(nearest.smallest(k));
  }

 private:
  [[nodiscard]] Pack<Scalar> group(std::size_t g) const { return Pack<Scalar>::load(&distances_[pack_width * g]); }

  alignas(64) std::array<Scalar, RunLink::max_points> distances_;
  std::size_t groups_;
};

/// Offers the points of a leaf that are nearer than the collector's bound.
template <class Scalar, int Dim, class Collector>
void scan_run(const PointGroup<Scalar, Dim>* groups, RunLink run, const Scalar* query, Collector& found) {
  const RunDistances<Scalar> distances(groups, run.groups(), query);
  std::uint32_t near = distances.below(found.bound());
  if constexpr (KeepsFew<Collector>) {
    // The first leaf of a search: most of its points would be put in the list to be put out again.
    constexpr int many = 10;
    if (std::popcount(near) > many)
      near = distances.below(std::min(found.bound(), distances.bound_for(static_cast<int>(found.k()))));
  }
  for (; near != 0; near &= near - 1) {
    const auto lane = static_cast<std::uint32_t>(std::countr_zero(near));
    if (distances[lane] < found.bound()) found.offer(run.slot(lane), distances[lane]);  // which may have come nearer
  }
}

/// Offers every point nearer than the collector's bound, the nearest box first. Where the bound only cuts off the end,
/// the order in which points are offered does not depend on it: a search that starts with a nearer bound ends alike.
template <class Tree, class Collector>
void search_nearest(const Tree& tree, const typename Tree::Scalar* query, Collector& found) {
  using Scalar = typename Tree::Scalar;
  /// A node gone through up to a child, whose key is `last`; keys differ, so those of later ones are larger.
  struct Frame {
    Pack<Scalar> keys;
    Scalar last;
    const typename Tree::Node* node;
  };
  if constexpr (std::is_same_v<Collector, RadiusList<Scalar>>) return search_within(tree, query, found);
  if (tree.height == 0) return;
  const auto is_near = [&found](Scalar key) {
    return key < std::clamp(found.bound(), Tree::Node::least_bound, far_key<Scalar>);
  };
  std::array<Frame, Tree::max_height> frames;
  std::size_t level = tree.height - 1;
  const typename Tree::Node* node = &tree.at(tree.root);
  for (;;) {
    const Pack<Scalar> keys = node->keys(query);
    Scalar key = keys.smallest();
    if (level == 0) {
      for (; is_near(key); key = keys.smallest_above(key)) {
        const RunLink run(node->link[lane_of(key)]);
        scan_run<Scalar, Tree::Dim>(tree.runs.groups(run), run, query, found);
      }
    } else if (is_near(key)) {
      frames[level] = {keys, key, node};
      node = &tree.at(node->link[lane_of(key)]);
      --level;
      continue;
    }
    do {
      if (++level == tree.height) return;
      key = frames[level].keys.smallest_above(frames[level].last);
    } while (!is_near(key));
    frames[level].last = key;
    node = &tree.at(frames[level].node->link[lane_of(key)]);
    --level;
  }
}

}  // namespace chainslam::detail
