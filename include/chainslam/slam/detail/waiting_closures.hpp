#pragma once

#include <span>

#include "chainslam/core/types.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::detail {

/// Closures that were accepted since the last optimization: those that hardly move anything wait for others.
class WaitingClosures {
 public:
  /// @param small_correction  metres at the scan, or at a point 10 m from it, that count as hardly any.
  void add(std::span<const Keyframe> keyframes, const LoopClosure& closure, double small_correction) {
    constexpr double lever = 10.0;
    const auto pose = [&](KeyframeId id) { return keyframes[static_cast<std::size_t>(id.value)].T_map_body; };
    const SE3d correction = closure.T_from_to.inverse() * (pose(closure.from).inverse() * pose(closure.to));
    moves_ |= !(correction.translation().norm() + lever * correction.rotation().log().norm() <= small_correction);
    ++count_;
  }

  [[nodiscard]] bool empty() const { return count_ == 0; }
  /// Whether they are to be optimized now. @param enough  so many are, however little they move.
  [[nodiscard]] bool are_due(Index enough) const { return count_ > 0 && (moves_ || count_ >= enough); }
  void clear() { *this = {}; }

 private:
  Index count_ = 0;
  bool moves_ = false;  ///< whether one of them corrects more
};

}  // namespace chainslam::detail
