#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/search/detail/point_lanes.hpp"

namespace chainslam::detail {

/// The leaves of a `KdTree`, in whose order points that are near one another mostly follow one another.
template <class Tree>
class TreeLeaves {
 public:
  using Scalar = typename Tree::Scalar;
  static constexpr int leaf_size = Tree::leaf_size;
  static constexpr auto dim = static_cast<std::size_t>(Tree::dimension);
  using Points = Lanes<Scalar, leaf_size, Tree::dimension>;
  using Corner = std::array<Scalar, dim>;

  explicit TreeLeaves(const Tree& tree) : tree_(&tree) {}

  [[nodiscard]] Index count() const { return static_cast<Index>(tree_->leaves_.size()); }
  /// Lanes that hold no point are infinite.
  [[nodiscard]] const Points& points(Index leaf) const { return tree_->leaves_[leaf].points; }
  /// The leaf of point i, which is in the tree.
  [[nodiscard]] Index leaf_of(Index i) const { return tree_->slot_of_point_[i] / static_cast<Index>(leaf_size); }
  /// The points of a leaf: the first lanes are those in use.
  [[nodiscard]] std::span<const Index> indices(Index leaf) const {
    const auto& columns = points(leaf).columns;
    std::size_t used = 0;
    for (std::size_t lane = 0; lane < leaf_size; ++lane) used += columns[0][lane] < Points::far ? 1U : 0U;
    return std::span(tree_->leaves_[leaf].indices).first(used);
  }

  /// Replaces `out` by the leaves whose cells lie within a distance of a box, in their order; by more than `most` of
  /// them if there are more.
  void near_box(const Corner& low, const Corner& high, Scalar squared_distance, std::size_t most,
                std::vector<Index>& out) const {
    out.clear();
    if (tree_->nodes_.empty()) return;
    std::array<Pending, Tree::max_depth> stack;
    std::size_t pending = 1;
    stack[0] = {{}, 0};
    while (pending > 0 && out.size() <= most) {
      Pending here = stack[--pending];
      for (;;) {
        const auto& node = tree_->nodes_[here.node];
        const std::uint32_t axis = node.axis();
        if (axis == Tree::leaf_axis) {
          const auto leaf = static_cast<Index>(node.link());
          out.push_back(leaf);
          break;
        }
        const Scalar below = low[axis] - node.split, above = node.split - high[axis];
        Pending upper = here;
        upper.offset[axis] = above > 0 ? above : here.offset[axis];
        upper.node = node.link();
        const bool reaches_upper = Tree::squared(upper.offset) <= squared_distance;
        here.offset[axis] = below > 0 ? below : here.offset[axis];
        here.node += 1;
        if (Tree::squared(here.offset) <= squared_distance) {
          if (reaches_upper) stack[pending++] = upper;
        } else if (reaches_upper) {
          here = upper;
        } else {
          break;
        }
      }
    }
  }

 private:
  /// A subtree: how far its cell lies from the box, axis by axis.
  struct Pending {
    Corner offset;
    std::uint32_t node;
  };

  const Tree* tree_;
};

}  // namespace chainslam::detail
