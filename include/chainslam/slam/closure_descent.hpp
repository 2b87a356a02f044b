#pragma once

#include <algorithm>
#include <cstddef>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/slam/back_end_options.hpp"
#include "chainslam/slam/chained_closer.hpp"
#include "chainslam/slam/closure_candidates.hpp"
#include "chainslam/slam/connected_components.hpp"
#include "chainslam/slam/frame_parting.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "chainslam/slam/submap.hpp"

namespace chainslam {

/// What is to be undone in a map.
struct UndoRequest {
  std::vector<SessionId> sessions{};  ///< these with all that touches them
  std::vector<Index> closures{};      ///< by position; of a merge, all places go that were accepted together
};

/// Of each closure of a merge, the position of the first of the places that were accepted together; -1 of others.
[[nodiscard]] [[gnu::cold]] inline detail::Table<Index> merge_events(const SlamMap& map) {
  const auto session = [&](KeyframeId id) { return detail::session_of(map, id).value; };
  ConnectedComponents joined(to_index(map.sessions.size()));
  detail::Table<Index> events;
  const LoopClosure* last = nullptr;  // of the merge at hand
  Index event = -1;
  for (const LoopClosure& closure : map.closures) {
    if (closure.kind != ClosureKind::merge) {
      events.push_back(-1);
      if (closure.kind != ClosureKind::chained) last = nullptr;
      continue;
    }
    const bool goes_on = last != nullptr && session(closure.to) == session(last->to) &&
                         joined.same(session(closure.from), session(last->from)) &&
                         joined.same(session(closure.from), session(closure.to));
    if (!goes_on) event = to_index(events.size());
    events.push_back(event);
    last = &closure;
    if (closure.verdict != ClosureVerdict::reverted) joined.connect(session(closure.from), session(closure.to));
  }
  return events;
}

namespace detail {

/// What was connected at some moment, and what still is without that which goes.
struct Connections {
  explicit Connections(Index nodes) : all(nodes), left(nodes) {}
  void connect(Index a, Index b, bool stays) {
    all.connect(a, b);
    if (stays) left.connect(a, b);
  }
  [[nodiscard]] bool lost(Index a, Index b) const { return all.same(a, b) && !left.same(a, b); }

  ConnectedComponents all, left;
};

/// Walks through a map's closures in the order in which they were accepted, and finds those whose reasons are gone.
class ClosureDescent {
 public:
  ClosureDescent(const SlamMap& map, const UndoRequest& request, const ChainOptions& chain)
      : map_(map),
        reach_(chain.reach),
        events_(merge_events(map)),
        gone_(static_cast<Offset>(map.closures.size()), 0),
        sessions_(to_index(map.sessions.size())),
        keyframes_(to_index(map.keyframes.size())) {
    for (const Index position : request.closures) gone_[position] = 1;
    const auto goes = [&](KeyframeId id) {
      return std::find(request.sessions.begin(), request.sessions.end(), session_of(map, id)) != request.sessions.end();
    };
    chained_.resize(map.closures.size());
    for (Index i = 0; i < to_index(map.closures.size()); ++i) {
      const LoopClosure& closure = at(i);
      if (goes(closure.from) || goes(closure.to)) gone_[i] = 1;
      if (closure.kind == ClosureKind::chained && closure.cause >= 0)
        chained_[static_cast<std::size_t>(closure.cause)].push_back(i);
    }
    for (Index i = 0; i < to_index(map.closures.size()); ++i) visit(i);
  }

  [[nodiscard]] const Table<char>& gone() const { return gone_; }

 private:
  [[nodiscard]] const LoopClosure& at(Index i) const { return map_.closures[static_cast<std::size_t>(i)]; }
  [[nodiscard]] Index session(KeyframeId id) const { return session_of(map_, id).value; }

  void visit(Index i) {
    const LoopClosure& closure = at(i);
    if (closure.cause >= 0 && gone_[closure.cause] != 0) gone_[i] = 1;
    if (events_[i] == i && merge_is_gone(i))
      for (Index k = i; k < events_.size(); ++k)
        if (events_[k] == i) gone_[k] = 1;
    // Keyframes of two sessions met since merges had joined these.
    if (closure.kind == ClosureKind::direct && sessions_.lost(session(closure.from), session(closure.to))) gone_[i] = 1;
    for (const Index k : chained_[static_cast<std::size_t>(i)])
      if (chain_is_gone(closure.from, at(k).from)) gone_[k] = 1;
    const bool stays = gone_[i] == 0;
    if (closure.is_factor()) keyframes_.connect(closure.from.value, closure.to.value, stays);
    if (closure.kind == ClosureKind::merge && closure.verdict != ClosureVerdict::reverted)
      sessions_.connect(session(closure.from), session(closure.to), stays);
  }

  /// Its places confirmed one another: without one of them, or what brought them into one frame, none does.
  [[nodiscard]] bool merge_is_gone(Index event) const {
    for (Index k = event; k < events_.size(); ++k)
      if (events_[k] == event && (gone_[k] != 0 || sessions_.lost(session(at(event).from), session(at(k).from))))
        return true;
    return false;
  }

  /// Whether k was found from j, or keyframes around it, by closures that are gone.
  [[nodiscard]] bool chain_is_gone(KeyframeId j, KeyframeId k) const {
    bool found = false, left = false;
    const SubmapRange around = submap_range(map_.keyframes, j, reach_);
    for (Index near = around.begin; near < around.end; ++near) {
      found |= keyframes_.all.same(near, k.value);
      left |= keyframes_.left.same(near, k.value);
    }
    return found && !left;
  }

  const SlamMap& map_;
  Index reach_;
  Table<Index> events_;
  Table<char> gone_;
  std::vector<std::vector<Index>> chained_;  ///< of each closure, those of its chain
  Connections sessions_;                     ///< by merges
  Connections keyframes_;                    ///< by closures
};

}  // namespace detail

/// Which closures go when something is undone: what is asked for, and all that descended from it. That is what its
/// records name as their cause; chains that went through it; a merge's other places; and between two sessions what was
/// found after merges had joined these and would not have been without them.
/// @param chain  as the closures were chained with.
/// @returns of each closure, whether it goes.
[[nodiscard]] [[gnu::cold]] inline detail::Table<char> descendants(const SlamMap& map, const UndoRequest& request,
                                                                   const ChainOptions& chain = {}) {
  return detail::ClosureDescent(map, request, chain).gone();
}

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
  /// @param undone  closures that are refused.
  Unrepeated(Closer closer, UndoneClosures undone) : closer_(std::move(closer)), undone_(std::move(undone)) {}

  /// As `Closer` has it.
  [[nodiscard]] bool eligible(const Keyframe& candidate, const Keyframe& query) const {
    return closer_.eligible(candidate, query);
  }
  /// An alignment of `Closer`, refused if it repeats one that was undone.
  template <Executor E = Serial>
  [[nodiscard]] LoopClosure align(std::span<const Keyframe> keyframes, KeyframeId from, KeyframeId to,
                                  const SE3d& guess, const E& executor = {}) {
    LoopClosure closure = closer_.align(keyframes, from, to, guess, executor);
    undone_.refuse_repeated(closure);
    return closure;
  }
  /// The same from a good guess.
  template <Executor E = Serial>
    requires requires(Closer& closer, std::span<const Keyframe> keyframes, KeyframeId id, const SE3d& guess,
                      const E& executor) {
      closer.refine(keyframes, id, id, guess, executor);
    }
  [[nodiscard]] LoopClosure refine(std::span<const Keyframe> keyframes, KeyframeId from, KeyframeId to,
                                   const SE3d& guess, const E& executor = {}) {
    LoopClosure closure = closer_.refine(keyframes, from, to, guess, executor);
    undone_.refuse_repeated(closure);
    return closure;
  }
  /// Several alignments, if `Closer` makes them at a time.
  template <Executor E = Serial>
  [[nodiscard]] std::vector<LoopClosure> align(std::span<const Keyframe> keyframes,
                                               std::span<const AlignmentGuess> guesses, KeyframeId to,
                                               const E& executor = {}) requires BatchAligner<Closer> {
    return refused(closer_.align(keyframes, guesses, to, executor));
  }
  /// The same from good guesses.
  template <Executor E = Serial>
  [[nodiscard]] std::vector<LoopClosure> refine(std::span<const Keyframe> keyframes,
                                                std::span<const AlignmentGuess> guesses, KeyframeId to,
                                                const E& executor = {}) requires BatchAligner<Closer> {
    return refused(closer_.refine(keyframes, guesses, to, executor));
  }
  /// What `Closer` finds for a keyframe, but for repetitions.
  template <Executor E = Serial>
  [[nodiscard]] std::vector<LoopClosure> search(std::span<const Keyframe> keyframes, const PositionIndex& index,
                                                KeyframeId query, const E& executor = {}) {
    return refused(closer_.search(keyframes, index, query, executor));
  }
  /// The same for the newest keyframe.
  template <Executor E = Serial>
  [[nodiscard]] std::vector<LoopClosure> close(std::span<const Keyframe> keyframes, const PositionIndex& index,
                                               const E& executor = {}) {
    return refused(closer_.close(keyframes, index, executor));
  }

  [[nodiscard]] const Closer& closer() const { return closer_; }  ///< the one given
  /// See the closer's.
  void free_submaps() requires requires(Closer& closer) { closer.free_submaps(); }
  { closer_.free_submaps(); }

 private:
  [[nodiscard]] std::vector<LoopClosure> refused(std::vector<LoopClosure> tried) const {
    for (LoopClosure& closure : tried) undone_.refuse_repeated(closure);
    return tried;
  }

  Closer closer_;
  UndoneClosures undone_;
};

}  // namespace chainslam
