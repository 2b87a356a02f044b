#pragma once

#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/slam/back_end_options.hpp"
#include "chainslam/slam/detail/fix_evidence.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::detail {

/// A place at which the current session was found in another frame, or elsewhere in its own.
struct MergeHypothesis {
  LoopClosure closure;        ///< the measurement
  double travelled = 0;       ///< metres from the session's start to `closure.to`
  bool needs_others = false;  ///< too few scans around it agree
};

/// Carries the current session's frame over into the other one's: x_j T_j_i x_i^-1.
[[nodiscard]] inline SE3d T_frame_joined(const SlamMap& map, const LoopClosure& closure) {
  const auto pose = [&](KeyframeId id) -> const SE3d& {
    return map.keyframes[static_cast<std::size_t>(id.value)].T_map_body;
  };
  return pose(closure.from) * closure.T_from_to * pose(closure.to).inverse();
}

/// Places that wait for others to agree with them. Those of different frames stand side by side; when a frame is
/// joined, the others of it are discarded.
class MergeHypotheses {
 public:
  /// Starts without hypotheses.
  explicit MergeHypotheses(const MergeOptions& options) : options_(options), evidence_(options.fixes) {}

  /// Adds one, at so many metres along the session's path.
  void add(const LoopClosure& closure, double travelled) { all_.push_back({closure, travelled}); }
  [[nodiscard]] detail::Table<MergeHypothesis>& all() { return all_; }  ///< all of them

  /// What the fixes of both sides say, if the closure is right: of two frames, or of two sessions of one.
  [[nodiscard]] [[gnu::cold]] FixVerdict ask_fixes(const SlamMap& map, const LoopClosure& closure) const;

  /// Positions of closures that hold sessions together where their fixes contradict it.
  [[nodiscard]] [[gnu::cold]] detail::Table<Index> contradicted(const SlamMap& map) const {
    return contradicted_closures(map, evidence_);
  }

  /// If enough others agree with the newest, settles them: as accepted, unless the fixes contradict them, or they lie
  /// in one frame and no fixes contradict what holds it together.
  /// @returns whether they are accepted.
  [[nodiscard]] [[gnu::cold]] bool confirm(const SlamMap& map, std::vector<LoopClosure>& tried);

  /// Accepts one by itself.
  [[gnu::cold]] void accept(const SlamMap& map, const MergeHypothesis& one, std::vector<LoopClosure>& tried) {
    detail::Table<char> agreeing;
    for (const MergeHypothesis& other : all_) agreeing.push_back(&other == &one ? 1 : 0);
    settle(map, agreeing, ClosureVerdict::accepted, tried);
  }

  /// Discards all. @returns them as refusals.
  [[nodiscard]] [[gnu::cold]] std::vector<LoopClosure> withdraw();

 private:
  [[nodiscard]] static SessionId session(const SlamMap& map, KeyframeId id) {
    return map.keyframes[static_cast<std::size_t>(id.value)].session;
  }
  [[nodiscard]] static SessionId frame(const SlamMap& map, KeyframeId id) {
    return map.sessions[static_cast<std::size_t>(session(map, id).value)].frame;
  }

  /// Whether two places put the newer of them at the same pose, as far as the paths between them can be trusted.
  [[nodiscard]] [[gnu::cold]] bool agree(const SlamMap& map, const MergeHypothesis& a, const MergeHypothesis& b) const;

  /// Moves to `tried` what is decided: others of a frame that is joined, as refusals, then those that agree.
  [[gnu::cold]] void settle(const SlamMap& map, const detail::Table<char>& agreeing, ClosureVerdict verdict,
                            std::vector<LoopClosure>& tried);

  MergeOptions options_;
  FixEvidence evidence_;
  detail::Table<MergeHypothesis> all_;
};

inline FixVerdict MergeHypotheses::ask_fixes(const SlamMap& map, const LoopClosure& closure) const {
  const SessionId there = frame(map, closure.from), here = frame(map, closure.to);
  const SessionId from = session(map, closure.from), to = session(map, closure.to);
  const auto is = [&](const Session& one, SessionId id, SessionId frame) {
    return there == here ? one.id == id : one.frame == frame;
  };
  return evidence_(
      map, [&](const Session& one) { return is(one, from, there); },
      [&](const Session& one) { return is(one, to, here); }, T_frame_joined(map, closure));
}

inline bool MergeHypotheses::confirm(const SlamMap& map, std::vector<LoopClosure>& tried) {
  const MergeHypothesis newest = all_.back();
  detail::Table<char> agreeing;
  Index count = 0;
  double last = -std::numeric_limits<double>::infinity();
  for (const MergeHypothesis& one : all_) {
    const bool is_newest = &one == &all_.back();
    const bool apart = one.travelled - last >= options_.min_place_distance &&
                       newest.travelled - one.travelled >= options_.min_place_distance;
    const bool agrees = is_newest || (apart && agree(map, one, newest));
    if (agrees) last = one.travelled;
    agreeing.push_back(agrees ? 1 : 0);
    count += agrees ? 1 : 0;
  }
  if (count < options_.confirmations) return false;
  const bool contradicted = ask_fixes(map, newest.closure) == FixVerdict::contradict;
  const bool one_frame = frame(map, newest.closure.from) == frame(map, newest.closure.to);
  const bool settled = one_frame && this->contradicted(map).empty();  // all that holds it there has been agreed with
  const ClosureVerdict verdict = contradicted ? ClosureVerdict::against_fixes
                                 : settled    ? ClosureVerdict::inconsistent
                                              : ClosureVerdict::accepted;
  settle(map, agreeing, verdict, tried);
  return verdict == ClosureVerdict::accepted;
}

inline void MergeHypotheses::settle(const SlamMap& map, const detail::Table<char>& agreeing, ClosureVerdict verdict,
                                    std::vector<LoopClosure>& tried) {
  detail::Table<MergeHypothesis> waiting;
  std::vector<LoopClosure> others, decided;
  SessionId joined;
  for (Offset k = 0; k < all_.size(); ++k)
    if (agreeing[k] != 0) joined = frame(map, all_[k].closure.from);
  for (Offset k = 0; k < all_.size(); ++k) {
    LoopClosure closure = all_[k].closure;
    if (agreeing[k] != 0) {
      closure.verdict = verdict;
      decided.push_back(closure);
    } else if (verdict == ClosureVerdict::accepted && frame(map, closure.from) == joined) {
      closure.verdict = ClosureVerdict::unconfirmed;
      others.push_back(closure);
    } else {
      waiting.push_back(all_[k]);
    }
  }
  for (const auto& list : {&others, &decided})
    for (const LoopClosure& closure : *list) tried.push_back(closure);
  all_ = std::move(waiting);
}

inline bool MergeHypotheses::agree(const SlamMap& map, const MergeHypothesis& a, const MergeHypothesis& b) const {
  if (frame(map, a.closure.from) != frame(map, b.closure.from)) return false;
  const SE3d& here = map.keyframes[static_cast<std::size_t>(b.closure.to.value)].T_map_body;
  const SE3d difference = (T_frame_joined(map, a.closure) * here).inverse() * (T_frame_joined(map, b.closure) * here);
  const double path = b.travelled - a.travelled;
  return difference.translation().norm() <= options_.agree_translation + options_.agree_per_metre * path &&
         difference.rotation().log().norm() <= options_.agree_rotation;
}

inline std::vector<LoopClosure> MergeHypotheses::withdraw() {
  std::vector<LoopClosure> refused;
  for (MergeHypothesis& one : all_) {
    one.closure.verdict = ClosureVerdict::unconfirmed;
    refused.push_back(one.closure);
  }
  all_.clear();
  return refused;
}

}  // namespace chainslam::detail
