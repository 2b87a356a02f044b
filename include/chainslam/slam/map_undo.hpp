#pragma once

#include <algorithm>
#include <cstddef>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/factor_graph/smoother_reports.hpp"
#include "chainslam/slam/closure_descent.hpp"
#include "chainslam/slam/frame_parting.hpp"
#include "chainslam/slam/map_graph.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam {

namespace detail {

/// Gives a session's keyframes their fixes as they came.
class ReplayedFixes {
 public:
  ReplayedFixes(const SlamMap& map, const Session& session)
      : keyframes_(map.keyframes), next_(session.first_keyframe), end_(session.end_keyframe()) {}

  /// Those that came after `newest` and before the keyframe behind it.
  template <class Give>
  void pass(KeyframeId newest, const Give& give) {
    std::vector<KeyframeFix> together;
    for (; next_ <= newest.value && next_ < end_; ++next_) {
      const Keyframe& keyframe = keyframes_[static_cast<std::size_t>(next_)];
      const GnssArrival& arrival = keyframe.gnss_arrival;
      if (!keyframe.gnss || !arrival.after.valid()) continue;
      if (newest < arrival.after) break;
      if (!arrival.with_previous && !together.empty()) {
        give(std::span(together));
        together.clear();
      }
      together.push_back({keyframe.id, *keyframe.gnss});
    }
    if (!together.empty()) give(std::span(together));
  }

 private:
  std::span<const Keyframe> keyframes_;
  Index next_, end_;
};

}  // namespace detail

/// Gives a back end one session of a map, as a new session: its frames, keyframes and fixes, in the order in which they
/// came. Maps of format 1.3 and before do not say when fixes came: there they come with their keyframes.
/// @param back_end        takes `begin_session`, `add` of frames, keyframes and fixes, as `BackEnd` does.
/// @param after_keyframe  called after each keyframe, with its number in `map`.
template <class Target, Executor E, class AfterKeyframe>
void replay(const SlamMap& map, const Session& session, Target& back_end, const E& executor,
            AfterKeyframe&& after_keyframe) {
  back_end.begin_session(session.name, executor);
  const std::vector<FrameRecord> of_session = map.frames.of(session.id);
  std::span<const FrameRecord> frames = of_session;
  detail::ReplayedFixes fixes(map, session);
  for (Index i = session.first_keyframe; i < session.end_keyframe(); ++i) {
    Keyframe keyframe = map.keyframes[static_cast<std::size_t>(i)];
    const auto behind = std::partition_point(frames.begin(), frames.end(),
                                             [&](const FrameRecord& frame) { return frame.time <= keyframe.time; });
    const auto count = static_cast<std::size_t>(behind - frames.begin());
    if (count > 0) back_end.add(frames.first(count));
    frames = frames.subspan(count);
    if (keyframe.gnss_arrival.after.valid()) keyframe.gnss.reset();
    keyframe.gnss_arrival = {};
    const Index offset = back_end.add(std::move(keyframe), executor).value - i;  // of the back end's numbers
    fixes.pass(KeyframeId{i}, [&](std::span<KeyframeFix> together) {
      for (KeyframeFix& one : together) one.keyframe.value += offset;
      back_end.add(std::span<const KeyframeFix>(together), executor);
    });
    after_keyframe(KeyframeId{i});
  }
  if (!frames.empty()) back_end.add(frames);
}

/// The same of all sessions of a map. A back end with the same settings then makes the same map, bit for bit, if it
/// made this one without loading others; `without` and `Unrepeated` leave something out.
template <class Target, Executor E, class AfterKeyframe>
void replay(const SlamMap& map, Target& back_end, const E& executor, AfterKeyframe&& after_keyframe) {
  for (const Session& session : map.sessions) replay(map, session, back_end, executor, after_keyframe);
}

/// The same, on one thread, without progress.
template <class Target>
void replay(const SlamMap& map, Target& back_end) {
  replay(map, back_end, Serial{}, [](KeyframeId) {});
}

/// A map without what was undone.
struct UndoneMap {
  SlamMap map;                    ///< what remains, renumbered
  UndoneClosures undone{};        ///< closures that were asked for, so that a `replay` does not find them again
  Index removed_keyframes = 0;    ///< of the sessions that were removed
  Index removed_closures = 0;     ///< with those that descended from what was asked for
  ConvergeReport optimization{};  ///< of `undo`
};

namespace detail {

/// New numbers of what stays; -1 of what goes.
struct Renumbering {
  Table<Index> sessions, keyframes, closures;

  Renumbering(const SlamMap& map, const UndoRequest& request, const Table<char>& gone) {
    Index next = 0;
    for (const Session& session : map.sessions) {
      const bool goes =
          std::find(request.sessions.begin(), request.sessions.end(), session.id) != request.sessions.end();
      sessions.push_back(goes ? -1 : next++);
    }
    next = 0;
    for (const Keyframe& keyframe : map.keyframes)
      keyframes.push_back(sessions[keyframe.session.value] < 0 ? -1 : next++);
    next = 0;
    for (Offset i = 0; i < gone.size(); ++i) closures.push_back(gone[i] != 0 ? -1 : next++);
  }

  [[nodiscard]] KeyframeId operator()(KeyframeId id) const { return KeyframeId{keyframes[id.value]}; }
  /// Whether the records of a closure's keyframes and of its cause stay.
  [[nodiscard]] bool keeps(const LoopClosure& closure) const {
    return keyframes[closure.from.value] >= 0 && keyframes[closure.to.value] >= 0 &&
           (closure.cause < 0 || closures[closure.cause] >= 0);
  }
  [[nodiscard]] LoopClosure operator()(LoopClosure closure) const {
    closure.from = (*this)(closure.from);
    closure.to = (*this)(closure.to);
    if (closure.cause >= 0) closure.cause = closures[closure.cause];
    return closure;
  }
};

/// A frame whose session goes is that of the first one left in it, held there.
[[gnu::cold]] inline void hand_over_frames(SlamMap& map, const Table<Index>& kept, const SqrtInformation<6>& anchor) {
  for (Session& heir : map.sessions) {
    const SessionId frame = heir.frame;
    if (kept[heir.id.value] < 0 || !frame.valid() || kept[frame.value] >= 0) continue;
    for (Session& other : map.sessions)
      if (other.frame == frame) other.frame = heir.id;
    if (heir.keyframes == 0) continue;
    heir.prior = map.keyframes[static_cast<std::size_t>(heir.first_keyframe)].T_map_body;
    heir.prior_sqrt_information = anchor;
  }
}

/// Leaves out what has no new number.
[[nodiscard]] [[gnu::cold]] inline SlamMap renumbered(const SlamMap& map, const Renumbering& numbers) {
  SlamMap left;
  for (Session session : map.sessions) {
    if (numbers.sessions[session.id.value] < 0) continue;
    session.id = SessionId{numbers.sessions[session.id.value]};
    if (session.frame.valid()) session.frame = SessionId{numbers.sessions[session.frame.value]};
    session.first_keyframe = left.sessions.empty() ? 0 : left.sessions.back().end_keyframe();
    left.sessions.push_back(std::move(session));
  }
  for (Keyframe keyframe : map.keyframes) {
    if (!numbers(keyframe.id).valid()) continue;
    keyframe.id = numbers(keyframe.id);
    keyframe.session = SessionId{numbers.sessions[keyframe.session.value]};
    if (KeyframeId& after = keyframe.gnss_arrival.after; after.valid()) after = numbers(after);
    left.keyframes.push_back(std::move(keyframe));
  }
  for (OdometryMeasurement step : map.odometry) {
    step.from = numbers(step.from);
    step.to = numbers(step.to);
    if (step.from.valid() && step.to.valid()) left.odometry.push_back(step);
  }
  for (FrameRecord frame : map.frames) {
    if (numbers.sessions[frame.session.value] < 0) continue;
    frame.session = SessionId{numbers.sessions[frame.session.value]};
    left.frames.push_back(frame);
  }
  for (std::size_t i = 0; i < map.closures.size(); ++i)
    if (numbers.closures[static_cast<Offset>(i)] >= 0) left.closures.push_back(numbers(map.closures[i]));
  for (const LoopClosure& refusal : map.refusals)
    if (numbers.keeps(refusal)) left.refusals.push_back(numbers(refusal));
  return left;
}

inline void require_in(const char* what, Index value, std::size_t count) {
  if (value < 0 || static_cast<std::size_t>(value) >= count)
    throw std::invalid_argument("undo: there is no " + std::string(what) + " " + std::to_string(value));
}

}  // namespace detail

/// Removes sessions and closures with all that descended from them (`descendants`), and parts frames that nothing holds
/// together any more: what leaves a frame goes back to where odometry has it. Poses are to be optimized then.
/// @param anchor  standard deviation of the prior that holds a new frame's first keyframe, metres and radians.
/// @throws std::invalid_argument for numbers that the map does not have, and if no session would be left.
[[nodiscard]] [[gnu::cold]] inline UndoneMap without(const SlamMap& map, const UndoRequest& request,
                                                     const ChainOptions& chain = {},
                                                     double anchor = MapGraphOptions{}.anchor) {
  for (const SessionId id : request.sessions) detail::require_in("session", id.value, map.sessions.size());
  for (const Index position : request.closures) detail::require_in("closure", position, map.closures.size());
  const detail::Table<char> gone = descendants(map, request, chain);
  const detail::Renumbering numbers(map, request, gone);
  const auto root = NoiseModel<6>::from_sigma(anchor).sqrt_information();
  SlamMap parted = map;
  for (std::size_t i = 0; i < map.closures.size(); ++i)
    if (gone[static_cast<Offset>(i)] != 0) parted.closures[i].verdict = ClosureVerdict::reverted;
  part_frames(parted, root);
  detail::hand_over_frames(parted, numbers.sessions, root);
  UndoneMap result{.map = detail::renumbered(parted, numbers)};
  if (result.map.sessions.empty()) throw std::invalid_argument("undo: no session would be left");
  result.removed_keyframes = to_index(map.keyframes.size() - result.map.keyframes.size());
  result.removed_closures = to_index(map.closures.size() - result.map.closures.size());
  const detail::Table<Index> events = merge_events(map);
  for (Index i = 0; i < to_index(map.closures.size()); ++i) {
    const LoopClosure& closure = map.closures[static_cast<std::size_t>(i)];
    const bool asked = std::any_of(request.closures.begin(), request.closures.end(),
                                   [&](Index one) { return one == i || (events[i] >= 0 && events[one] == events[i]); });
    if (asked && numbers(closure.from).valid() && numbers(closure.to).valid()) {
      LoopClosure undone = closure;
      undone.from = numbers(closure.from);
      undone.to = numbers(closure.to);
      result.undone.add(result.map, undone);
    }
  }
  return result;
}

/// Brings a map to the exact optimum of its measurements, outliers decided as the back end does at its end.
/// @returns how that ended; if it failed, poses are as they were.
template <class Outliers = GroupGnc>
[[gnu::cold]] ConvergeReport settle(SlamMap& map, MapGraphOptions options = {}, Outliers outliers = {}) {
  constexpr int max_rounds = 30;     // each georeferences the map again, and decides outliers again
  constexpr double still = 1e-11;    // metres and radians
  options.remeasure_loaded = false;  // measurements stay what they were
  options.optimizer.relative_tolerance = 0;
  options.optimizer.absolute_tolerance = 1e-20;  // of the squared error: 1e-10 standard deviations
  MapGraph<Outliers> graph(options, std::move(outliers));
  graph.load(map);
  ConvergeReport report;
  for (int round = 0; round < max_rounds; ++round) {
    report = graph.converge();
    if (!report.ok()) return report;
    double moved = 0;
    for (std::size_t i = 0; i < map.keyframes.size(); ++i)
      moved = std::max(moved, map.keyframes[i].T_map_body.local(graph.map().keyframes[i].T_map_body).norm());
    map = graph.map();
    if (!graph.part() && moved < still) break;
  }
  return report;
}

/// `without`, and then `settle`: the exact optimum of what remains, without trying a scan.
template <class Outliers = GroupGnc>
[[nodiscard]] [[gnu::cold]] UndoneMap undo(const SlamMap& map, const UndoRequest& request,
                                           const ChainOptions& chain = {}, const MapGraphOptions& options = {},
                                           Outliers outliers = {}) {
  UndoneMap result = without(map, request, chain, options.anchor);
  result.optimization = settle(result.map, options, std::move(outliers));
  return result;
}

}  // namespace chainslam
