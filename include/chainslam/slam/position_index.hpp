#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <concepts>
#include <span>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/map/keyframe.hpp"
#include "chainslam/search/kd_tree.hpp"

namespace chainslam {

/// Finds keyframes by where the graph believes they are.
///
/// A k-d tree over the positions at the last `rebuild`, and a plain list of those appended since, which is folded into
/// the tree when it has grown to the tree's square root.
class PositionIndex {
 public:
  /// Takes all positions anew: after the graph has moved them, or after frames were joined.
  /// @param chosen  which keyframes to hold: those whose T_map_body are in one frame.
  template <std::predicate<const Keyframe&> Chosen>
  void rebuild(std::span<const Keyframe> keyframes, Chosen&& chosen) {
    ids_.clear();
    positions_.clear();
    for (const Keyframe& keyframe : keyframes) {
      if (!chosen(keyframe)) continue;
      ids_.push_back(keyframe.id);
      positions_.push_back(keyframe.T_map_body.translation());
    }
    fold();
  }
  void rebuild(std::span<const Keyframe> keyframes) {
    rebuild(keyframes, [](const Keyframe&) { return true; });
  }

  /// Adds the next keyframe; ids must ascend.
  void append(KeyframeId id, const Eigen::Vector3d& position) {
    ids_.push_back(id);
    positions_.push_back(position);
    const std::size_t listed = positions_.size() - in_tree_;
    if (listed > 64 && listed * listed > positions_.size()) fold();
  }

  /// A keyframe and its distance from the query, metres. Ordered by the distance; equal distances by id.
  struct Found {
    KeyframeId id;
    double distance = 0;

    [[nodiscard]] bool operator<(const Found& other) const {
      return distance != other.distance ? distance < other.distance : id < other.id;
    }
  };

  /// All keyframes within `radius` metres of `center`, nearest first; equal distances by id.
  [[nodiscard]] std::vector<Found> within(const Eigen::Vector3d& center, double radius) const {
    std::vector<Neighbor<double>> neighbors;
    tree_.within(center, radius, neighbors);
    std::vector<Found> found;
    const auto add = [&](std::size_t i) {
      const Eigen::Vector3d way = positions_[i] - center;
      const double distance = way.norm();
      if (distance <= radius) found.push_back({ids_[i], distance});
    };
    for (const auto& neighbor : neighbors) add(static_cast<std::size_t>(neighbor.index));
    for (std::size_t i = in_tree_; i < positions_.size(); ++i) add(i);
    std::sort(found.begin(), found.end());
    return found;
  }

  [[nodiscard]] std::size_t size() const { return positions_.size(); }

 private:
  void fold() {
    tree_ = KdTree<double>(positions_);
    in_tree_ = positions_.size();
  }

  std::vector<KeyframeId> ids_;  // ascending
  std::vector<Eigen::Vector3d> positions_;
  KdTree<double> tree_;
  std::size_t in_tree_ = 0;
};

}  // namespace chainslam
