#pragma once

#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/map/slam_map.hpp"
#include "chainslam/slam/merge_options.hpp"
#include "chainslam/slam/position_index.hpp"

namespace chainslam {

/// Closures that a user has undone, and what would repeat them when scans are tried again: a direct or chained one is
/// repeated by any between the same keyframes, a merge by any that puts the session to the same place.
class UndoneClosures {
 public:
  /// @param map  has the closure's keyframes, by the numbers that they have when scans are tried again.
  void add(const SlamMap& map, const LoopClosure& closure) {
    const Keyframe& to = map.keyframes[static_cast<std::size_t>(closure.to.value)];
    all_.push_back({closure, to.session, to.T_odom_body});
  }
  [[nodiscard]] bool empty() const { return all_.empty(); }  ///< whether none was undone

  /// An alignment that was accepted becomes `reverted` if it repeats a direct or chained closure that was undone.
  void refuse_repeated(LoopClosure& closure) const {
    if (closure.verdict != ClosureVerdict::accepted) return;
    for (const Undone& one : all_) {
      const auto& [from, to] = std::pair(one.closure.from, one.closure.to);
      const bool same = (closure.from == from && closure.to == to) || (closure.from == to && closure.to == from);
      if (one.closure.kind != ClosureKind::merge && same) closure.verdict = ClosureVerdict::reverted;
    }
  }

  /// The same of a merge's place. Two places put a session to the same pose as `options` has it for places that
  /// confirm each other.
  void refuse_repeated_merge(const SlamMap& map, const MergeOptions& options, LoopClosure& closure) const {
    if (closure.verdict != ClosureVerdict::accepted) return;
    for (const Undone& one : all_)
      if (one.closure.kind == ClosureKind::merge && is_same_merge(map, options, one, closure))
        closure.verdict = ClosureVerdict::reverted;
  }

 private:
  struct Undone {
    LoopClosure closure;
    SessionId session;  ///< of `closure.to`
    SE3d T_odom_to;     ///< of `closure.to`, which the map may not have yet
  };

  [[nodiscard]] static bool is_same_merge(const SlamMap& map, const MergeOptions& options, const Undone& undone,
                                          const LoopClosure& closure) {
    const auto keyframe = [&](KeyframeId id) -> const Keyframe& {
      return map.keyframes[static_cast<std::size_t>(id.value)];
    };
    const auto frame = [&](KeyframeId id) {
      return map.sessions[static_cast<std::size_t>(keyframe(id).session.value)].frame;
    };
    const KeyframeId from = undone.closure.from;
    if (keyframe(closure.to).session != undone.session || from.value >= to_index(map.keyframes.size()) ||
        frame(from) != frame(closure.from))
      return false;
    const SE3d T_undone_now = undone.T_odom_to.inverse() * keyframe(closure.to).T_odom_body;
    const SE3d expected = keyframe(closure.from).T_map_body.inverse() * keyframe(from).T_map_body *
                          undone.closure.T_from_to * T_undone_now;
    const SE3d difference = expected.inverse() * closure.T_from_to;
    const double apart = T_undone_now.translation().norm();
    return difference.translation().norm() <= options.agree_translation + options.agree_per_metre * apart &&
           difference.rotation().log().norm() <= options.agree_rotation;
  }

  std::vector<Undone> all_;
};

/// A closer that refuses what would repeat closures that were undone; in all else the one given.
/// @tparam Closer  finds and aligns closures, as `LoopCloser` does.
template <class Closer>
class Unrepeated {
 public:
  Unrepeated(Closer closer, UndoneClosures undone) : closer_(std::move(closer)), undone_(std::move(undone)) {}

  /// As `Closer` has them.
  /// @{
  [[nodiscard]] bool eligible(const Keyframe& candidate, const Keyframe& query) const {
    return closer_.eligible(candidate, query);
  }
  template <Executor E = Serial>
  [[nodiscard]] LoopClosure align(std::span<const Keyframe> keyframes, KeyframeId from, KeyframeId to,
                                  const SE3d& guess, const E& executor = {}) {
    LoopClosure closure = closer_.align(keyframes, from, to, guess, executor);
    undone_.refuse_repeated(closure);
    return closure;
  }
  template <Executor E = Serial>
  [[nodiscard]] std::vector<LoopClosure> search(std::span<const Keyframe> keyframes, const PositionIndex& index,
                                                KeyframeId query, const E& executor = {}) {
    return refused(closer_.search(keyframes, index, query, executor));
  }
  template <Executor E = Serial>
  [[nodiscard]] std::vector<LoopClosure> close(std::span<const Keyframe> keyframes, const PositionIndex& index,
                                               const E& executor = {}) {
    return refused(closer_.close(keyframes, index, executor));
  }
  /// @}

  [[nodiscard]] const Closer& closer() const { return closer_; }  ///< the one given

 private:
  [[nodiscard]] std::vector<LoopClosure> refused(std::vector<LoopClosure> tried) const {
    for (LoopClosure& closure : tried) undone_.refuse_repeated(closure);
    return tried;
  }

  Closer closer_;
  UndoneClosures undone_;
};

}  // namespace chainslam
