#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <utility>

#include "chainslam/core/table.hpp"
#include "chainslam/slam/closure_candidates.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::detail {

/// Metres from the keyframe before, by odometry.
[[nodiscard]] inline double step_length(std::span<const Keyframe> keyframes, KeyframeId id) {
  const auto at = [&](Index i) -> const SE3d& { return keyframes[static_cast<std::size_t>(i)].T_odom_body; };
  return (at(id.value - 1).inverse() * at(id.value)).translation().norm();
}

/// The searches along a session that a merge asks for; they are made bit by bit.
class Recheck {
 public:
  /// @param joined  of each session, whether it was in the frame that `session` came into.
  /// @param cause   the merge's closure, among those of the map.
  Recheck(const Session& session, detail::Table<char> joined, Index cause)
      : joined_(std::move(joined)),
        cause_(cause),
        first_(session.first_keyframe),
        next_(session.first_keyframe),
        end_(session.end_keyframe()) {}

  /// Where the keyframes are that the session is to be closed with. @param index  says how well they are known.
  [[nodiscard]] [[gnu::cold]] const PositionIndex& others(std::span<const Keyframe> keyframes,
                                                          const PositionIndex& index = {}) {
    if (std::exchange(outdated_, false)) {
      others_ = index;
      others_.rebuild(keyframes, [&](const Keyframe& there) { return joined_[there.session.value] != 0; });
    }
    return others_;
  }
  /// The graph has moved a keyframe.
  void move(const Keyframe& keyframe) { others_.move(keyframe.id, keyframe.T_map_body.translation()); }
  /// The graph has moved any keyframes.
  void moved_all() { outdated_ = true; }
  [[nodiscard]] Index cause() const { return cause_; }  ///< the closure that led to it, by its position
  /// Whether what led to it was reverted.
  [[nodiscard]] bool is_reverted(const SlamMap& map) const {
    return map.closures[static_cast<std::size_t>(cause_)].verdict == ClosureVerdict::reverted;
  }

  /// The next keyframe to search from, `travel` metres along the path from the last one; none: all are done.
  [[nodiscard]] [[gnu::cold]] std::optional<KeyframeId> next(std::span<const Keyframe> keyframes, double travel) {
    while (next_ < end_) {
      const KeyframeId id{next_++};
      if (id.value > first_) travelled_ += step_length(keyframes, id);
      if (id.value > first_ && travelled_ < travel) continue;
      travelled_ = 0;
      if (pause_ == 0) return id;
      --pause_;
    }
    return std::nullopt;
  }

  /// Passes over so many of those that would be next.
  void pause(Index count) { pause_ = count; }

 private:
  detail::Table<char> joined_;
  PositionIndex others_;
  bool outdated_ = true;  ///< whether `others_` is to be made again
  Index cause_ = -1;
  Index first_ = 0, next_ = 0, end_ = 0;  ///< keyframes
  double travelled_ = 0;                  ///< metres since the last search
  Index pause_ = 0;
};

/// Keyframes of the current session that the graph has moved since closures were searched from them: their neighbours
/// are others now.
class MovedKeyframes {
 public:
  void begin_session() { searched_from_ = {}; }  ///< forgets where keyframes were tried

  /// A search was made from the session's newest keyframe.
  void searched(const Keyframe& newest) { searched_from_.push_back(newest.T_map_body.translation()); }

  /// The session was moved as a whole: its keyframes have the neighbours in it that they had.
  void moved_together(std::span<const Keyframe> keyframes, const Session& session) {
    for (Offset k = 0; k < searched_from_.size(); ++k)
      searched_from_[k] = keyframes[static_cast<std::size_t>(session.first_keyframe + k)].T_map_body.translation();
  }

  /// A new pass over the session begins.
  void begin_pass(double travel) {
    next_ = 0;
    travelled_ = travel;
  }

  /// The next keyframe of this pass that lies more than `moved` metres from where it was, `travel` metres along the
  /// path from the one before; none: the pass is over.
  [[nodiscard]] [[gnu::cold]] std::optional<KeyframeId> next(std::span<const Keyframe> keyframes,
                                                             const Session& session, double moved, double travel) {
    while (next_ < searched_from_.size()) {
      const Offset k = next_++;
      const KeyframeId id{session.first_keyframe + static_cast<Index>(k)};
      if (k > 0) travelled_ += step_length(keyframes, id);
      const Eigen::Vector3d& now = keyframes[static_cast<std::size_t>(id.value)].T_map_body.translation();
      const Eigen::Vector3d way = now - searched_from_[k];
      if (!(way.norm() > moved)) continue;
      searched_from_[k] = now;
      if (travelled_ < travel) continue;
      travelled_ = 0;
      return id;
    }
    return std::nullopt;
  }

 private:
  detail::Table<Eigen::Vector3d> searched_from_;  ///< of each keyframe of the session
  Offset next_ = 0;
  double travelled_ = 0;  ///< metres since the last one
};

}  // namespace chainslam::detail
