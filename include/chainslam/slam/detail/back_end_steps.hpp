#pragma once

#include <concepts>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/slam/back_end.hpp"

// What `BackEnd` does with a keyframe, a fix, a map.

namespace chainslam {

template <class Closer, class Chainer, class Merger, class Outliers>
void BackEnd<Closer, Chainer, Merger, Outliers>::load(const SlamMap& map) {
  catch_up();
  const Index known = to_index(graph_.map().closures.size());
  withdraw();
  in_session_ = false;
  graph_.load(map);
  connect_closures(closure_graph_, graph_.map(), known);
  part();
}

template <class Closer, class Chainer, class Merger, class Outliers>
void BackEnd<Closer, Chainer, Merger, Outliers>::begin_session(std::string name) {
  catch_up();
  withdraw();
  moved_.begin_session();
  gnss_ = GnssInterpolator();  // the clocks of two drives have nothing in common
  graph_.begin_session(std::move(name));
  in_session_ = true;
  index_positions();
}

template <class Closer, class Chainer, class Merger, class Outliers>
void BackEnd<Closer, Chainer, Merger, Outliers>::add(std::span<const FrameRecord> frames) {
  if (!in_session_) begin_session({});
  graph_.append(frames);
}

template <class Closer, class Chainer, class Merger, class Outliers>
template <Executor E>
KeyframeId BackEnd<Closer, Chainer, Merger, Outliers>::add(Keyframe keyframe, const E& executor) {
  if (!in_session_) {
    require_finite(keyframe);
    begin_session({});
  }
  const KeyframeId id = graph_.append(std::move(keyframe));
  allow(options_.max_alignments);
  positions_.append(id, map().keyframes.back().T_map_body.translation());
  gnss_.add(id, map().keyframes.back().time);
  const bool found = may_close() && take(closer_.close(map().keyframes, positions_, executor), -1, true, executor);
  // Where the last one failed, fixes do not make the next one better.
  if (found || graph_.is_unfinished() || (graph_.waiting_fixes() >= options_.fixes_at_once && counts_.last.ok()))
    optimise();
  moved_.searched(map().keyframes.back());
  try_merge(id, executor);
  recheck(executor);
  search_moved(executor);
  publish_frame();
  return id;
}

template <class Closer, class Chainer, class Merger, class Outliers>
template <Executor E>
void BackEnd<Closer, Chainer, Merger, Outliers>::add(std::span<const KeyframeFix> fixes, const E& executor) {
  if (fixes.empty()) return;
  for (const KeyframeFix& one : fixes) graph_.set_gnss(one.keyframe, one.fix, &one != fixes.data());
  for (const KeyframeFix& one : fixes) try_merge(one.keyframe, executor);
  recheck(executor);
  publish_frame();
}

template <class Closer, class Chainer, class Merger, class Outliers>
void BackEnd<Closer, Chainer, Merger, Outliers>::conclude() {
  catch_up();
  withdraw();
  if (!map().closures.empty()) {
    graph_.converge();
    catch_up();
    counts_.end = graph_.converge();
    if (part()) counts_.end = graph_.converge();
    count_optimisation(counts_.end.ok());
  }
  publish_frame();
}

template <class Closer, class Chainer, class Merger, class Outliers>
std::shared_ptr<const SlamMap> BackEnd<Closer, Chainer, Merger, Outliers>::finish() {
  conclude();
  return snapshot();
}

template <class Closer, class Chainer, class Merger, class Outliers>
template <Executor E>
bool BackEnd<Closer, Chainer, Merger, Outliers>::take(std::vector<LoopClosure> tried, Index cause, bool chain,
                                                      const E& executor) {
  counts_.alignments += to_index(tried.size());
  bool accepted = false;
  for (LoopClosure& closure : tried) {
    closure.cause = cause;
    if (closure.verdict != ClosureVerdict::accepted) {
      graph_.refuse(closure);
      continue;
    }
    closure_graph_.resize(to_index(map().keyframes.size()));
    if (closure_graph_.connected(closure.from.value, closure.to.value)) continue;  // a merge has measured it already
    take(closure, chain, executor);
    accepted = true;
  }
  return accepted;
}

template <class Closer, class Chainer, class Merger, class Outliers>
template <Executor E>
Index BackEnd<Closer, Chainer, Merger, Outliers>::take(LoopClosure closure, bool chain, const E& executor) {
  std::vector<LoopClosure> chained;
  closure_graph_.resize(to_index(map().keyframes.size()));
  if (chain)
    chained = chainer_.close(map().keyframes, closure_graph_, closure, session().first_keyframe, closer_, executor);
  counts_.alignments += to_index(chained.size());
  const Index position = graph_.accept(closure);
  for (LoopClosure& one : chained) {
    one.cause = position;
    if (one.verdict == ClosureVerdict::accepted)
      graph_.accept(one);
    else
      graph_.refuse(one);
  }
  connect_closures(closure_graph_, map(), position);
  return position;
}

template <class Closer, class Chainer, class Merger, class Outliers>
template <Executor E>
void BackEnd<Closer, Chainer, Merger, Outliers>::try_merge(KeyframeId query, const E& executor) {
  if constexpr (!std::same_as<Merger, NoMerging>) {
    if (std::exchange(held_after_, counts_.optimisations) != counts_.optimisations) part();
    if (keyframe(query).session != session().id) return;
    std::vector<LoopClosure> accepted;
    for (const LoopClosure& closure : merger_.attempt(map(), query, closer_, executor)) {
      if (closure.verdict == ClosureVerdict::accepted)
        accepted.push_back(closure);
      else
        graph_.refuse(closure);
    }
    if (!accepted.empty()) merge(accepted, executor);
  }
}

template <class Closer, class Chainer, class Merger, class Outliers>
template <Executor E>
void BackEnd<Closer, Chainer, Merger, Outliers>::merge(const std::vector<LoopClosure>& closures, const E& executor) {
  const LoopClosure& newest = closures.back();
  const auto frame = [&](KeyframeId id) { return graph_.frame(keyframe(id)); };
  if constexpr (requires { merger_.contradicted(map()); })
    if (frame(newest.from) == frame(newest.to)) part(merger_.contradicted(map()).all());
  detail::Table<char> joined;  // of each session, whether it is
  for (const Session& session : map().sessions) joined.push_back(session.frame == frame(newest.from) ? 1 : 0);
  graph_.join(newest);
  ++counts_.merges;
  Index position = -1;
  for (const LoopClosure& closure : closures)
    position = take(closure, options_.chain_merges && !closure.sqrt_information.isZero(0), executor);
  optimise();
  rechecks_.emplace_back(session(), std::move(joined), position);
  moved_.moved_together(map().keyframes, session());
}

template <class Closer, class Chainer, class Merger, class Outliers>
template <Executor E>
void BackEnd<Closer, Chainer, Merger, Outliers>::recheck(const E& executor) {
  if constexpr (!std::same_as<Merger, NoMerging>) {
    while (!rechecks_.empty() && !spent()) {
      Recheck& one = rechecks_.front();
      const std::optional<KeyframeId> id = one.next(map().keyframes, options_.recheck_travel);
      if (!id) {
        rechecks_.erase(rechecks_.begin());
        continue;
      }
      auto tried = closer_.search(map().keyframes, one.others(map().keyframes, positions_), *id, executor);
      if (!take(std::move(tried), one.cause(), options_.chain_in_recheck, executor)) continue;
      one.pause(options_.recheck_pause);
      optimise();
    }
  }
}

template <class Closer, class Chainer, class Merger, class Outliers>
void BackEnd<Closer, Chainer, Merger, Outliers>::publish_frame() {
  if (map().keyframes.empty()) return;
  const Keyframe& newest = map().keyframes.back();
  T_map_odom_.store(std::make_shared<const SE3d>(newest.T_map_body * newest.T_odom_body.inverse()));
}

}  // namespace chainslam
