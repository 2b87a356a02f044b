#pragma once

#include <concepts>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/slam/back_end.hpp"
#include "chainslam/slam/detail/repeated_searches.hpp"
#include "chainslam/slam/slam_map.hpp"

// How `BackEnd` joins frames, and what it searches again then.

namespace chainslam {

template <class Closer, class Chainer, class Merger, class Outliers>
template <Executor E>
void BackEnd<Closer, Chainer, Merger, Outliers>::try_merge(KeyframeId query, const E& executor) {
  if constexpr (!std::same_as<Merger, NoMerging>) {
    if (std::exchange(held_after_, counts_.optimizations) != counts_.optimizations) part();
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
  index_positions();
  ++counts_.merges;
  Index position = -1;
  for (const LoopClosure& closure : closures)
    position = take(closure, options_.chain_merges && !closure.sqrt_information.isZero(0), executor);
  optimize();
  rechecks_.emplace_back(session(), std::move(joined), position);
  moved_.moved_together(map().keyframes, session());
  if (options_.max_alignments > 0) alignments_end_ = counts_.alignments;  // the keyframe has caused enough
}

template <class Closer, class Chainer, class Merger, class Outliers>
template <Executor E>
void BackEnd<Closer, Chainer, Merger, Outliers>::recheck(const E& executor) {
  if constexpr (!std::same_as<Merger, NoMerging>) {
    while (!rechecks_.empty() && !spent()) {
      detail::Recheck& one = rechecks_.front();
      const std::optional<KeyframeId> id = one.next(map().keyframes, options_.recheck_travel);
      if (!id) {
        rechecks_.erase(rechecks_.begin());
        continue;
      }
      auto tried = closer_.search(map().keyframes, one.others(map().keyframes, positions_), *id, executor);
      if (!take(std::move(tried), one.cause(), options_.chain_in_recheck, executor)) continue;
      one.pause(options_.recheck_pause);
      if (is_due()) optimize();
    }
  }
}

}  // namespace chainslam
