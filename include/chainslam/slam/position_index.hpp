#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <concepts>
#include <span>
#include <vector>

#include "chainslam/core/ranked.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/map/keyframe.hpp"

namespace chainslam {

/// Finds keyframes by their estimated positions in the graph.
///
/// A list that is searched linearly: it is rebuilt whenever the graph has moved and searched once for each attempt to
/// close a loop, too rarely for the rebuilding of a tree to pay.
class PositionIndex {
 public:
  /// Updates all positions: after the graph has moved them, or after frames were joined.
  /// @param chosen  which keyframes to hold: those whose T_map_body are in one frame.
  template <std::predicate<const Keyframe&> Chosen>
  void rebuild(std::span<const Keyframe> keyframes, Chosen&& chosen) {
    ids_.clear();
    positions_.clear();
    for (const Keyframe& keyframe : keyframes)
      if (chosen(keyframe)) append(keyframe.id, keyframe.T_map_body.translation());
  }
  /// Indexes the positions of all keyframes, in O(n log n).
  void rebuild(std::span<const Keyframe> keyframes) {
    rebuild(keyframes, [](const Keyframe&) { return true; });
  }

  /// Adds the next keyframe; ids must ascend.
  void append(KeyframeId id, const Eigen::Vector3d& position) {
    ids_.push_back(id);
    positions_.push_back(position);
  }

  /// Lets somebody say how well the graph knows where one keyframe is from another.
  /// @param covariance  `Matrix6d covariance(KeyframeId from, KeyframeId to)` of T_from_to, tangent [translation;
  /// rotation], metres and radians; must outlive this.
  template <class Covariance>
  void set_covariance(const Covariance& covariance) {
    covariance_ = &covariance;
    call_ = [](const void* callable, KeyframeId from, KeyframeId to) -> Matrix6d {
      return (*static_cast<const Covariance*>(callable))(from, to);
    };
  }
  /// Zero if nobody says.
  [[nodiscard]] Matrix6d covariance(KeyframeId from, KeyframeId to) const {
    return covariance_ != nullptr ? call_(covariance_, from, to) : zeros<Matrix6d>();
  }

  /// A keyframe and its distance from the query, metres.
  struct Found {
    KeyframeId id;        ///< the keyframe
    double distance = 0;  ///< metres
  };
  /// Puts the nearest first, equally near ones by id.
  [[gnu::cold]] static void sort(std::span<Found> found) {
    detail::Table<Ranked> order;
    for (const Found& one : found) order.push_back({one.distance, one.id.value});
    sort_ranked(order.all());
    for (std::size_t k = 0; k < found.size(); ++k) found[k] = {KeyframeId{order.all()[k].index}, order.all()[k].rank};
  }

  /// All keyframes within `radius` metres of `center`, nearest first; equal distances by id.
  [[nodiscard]] std::vector<Found> within(const Eigen::Vector3d& center, double radius) const {
    std::vector<Found> found;
    for (Offset i = 0; i < positions_.size(); ++i) {
      const Eigen::Vector3d way = positions_[i] - center;
      const double distance = way.norm();
      if (distance <= radius) found.push_back({ids_[i], distance});
    }
    sort(found);
    return found;
  }

  /// Whether it holds a keyframe.
  [[nodiscard]] bool contains(KeyframeId id) const { return std::binary_search(ids_.begin(), ids_.end(), id); }
  /// Number of positions.
  [[nodiscard]] std::size_t size() const { return static_cast<std::size_t>(positions_.size()); }

 private:
  detail::Table<KeyframeId> ids_;  // ascending
  detail::Table<Eigen::Vector3d> positions_;
  const void* covariance_ = nullptr;  ///< who says, and how to ask
  Matrix6d (*call_)(const void* callable, KeyframeId from, KeyframeId to) = nullptr;
};

}  // namespace chainslam
