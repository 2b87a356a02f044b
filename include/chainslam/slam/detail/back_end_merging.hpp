#pragma once

#include <concepts>
#include <optional>
#include <utility>
#include <vector>

#include "chainslam/slam/back_end.hpp"

// How `BackEnd` joins the frames of sessions, and searches along what it joined; included by back_end.hpp.

namespace chainslam {

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

}  // namespace chainslam
