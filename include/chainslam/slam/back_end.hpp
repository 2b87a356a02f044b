#pragma once

#include <algorithm>
#include <concepts>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/channel.hpp"
#include "chainslam/core/compiled.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/slam/back_end_options.hpp"
#include "chainslam/slam/chained_closer.hpp"
#include "chainslam/slam/closure_candidates.hpp"
#include "chainslam/slam/detail/repeated_searches.hpp"
#include "chainslam/slam/detail/waiting_closures.hpp"
#include "chainslam/slam/gnss_candidates.hpp"
#include "chainslam/slam/loop_closer.hpp"
#include "chainslam/slam/map_graph.hpp"
#include "chainslam/slam/map_merger.hpp"

namespace chainslam {

/// Keeps the keyframes of all sessions in one pose graph, closes loops, chains them, joins sessions, and optimizes.
///
/// All work is done inside `add`, in the order of the calls: the same keyframes give the same map, bit for bit. Only
/// one thread may call `load`, `add`, `begin_session` and `finish`; `snapshot` and `T_map_odom` may be read by any.
/// Each session starts in a frame of its own, where its odometry says, and is moved as a whole by a merge. Loaded maps
/// count as earlier sessions.
/// @tparam Closer   finds closures: `LoopCloser` with its policies.
/// @tparam Chainer  finds more of them from each: `ChainedCloser`, or `NoChaining`.
/// @tparam Merger   joins frames: `MapMerger` with its policies, or `NoMerging`.
/// @tparam Outliers what becomes of measurements that the others contradict: `GroupGnc`, or a robust kernel.
template <class Closer = LoopCloser<>, class Chainer = ChainedCloser, class Merger = MapMerger<>,
          class Outliers = GroupGnc>
class BackEnd {
  static_assert(ClosureFinder<Closer>,
                "BackEnd: Closer needs `std::vector<LoopClosure> close(keyframes, index, executor)`, as in LoopCloser");
  static_assert(ClosureAligner<Closer> || (std::same_as<Chainer, NoChaining> && std::same_as<Merger, NoMerging>),
                "BackEnd: with a Chainer or a Merger, Closer needs `LoopClosure align(keyframes, from, to, guess, "
                "executor)` and `bool eligible(candidate, query) const`, as in LoopCloser");

 public:
  /// An empty map. Policies are moved in, with their settings.
  [[gnu::cold]] explicit BackEnd(const BackEndOptions& options = {}, Closer closer = Closer{},
                                 Chainer chainer = Chainer{}, Merger merger = Merger{}, Outliers outliers = Outliers{})
      : options_(options),
        closer_(std::move(closer)),
        chainer_(std::move(chainer)),
        merger_(std::move(merger)),
        graph_(options.graph, std::move(outliers)) {
    positions_.set_covariance(covariance_);
  }

  /// Adds a saved map: its sessions count as earlier ones. Keyframes of the first keep their numbers, others get new
  /// ones.
  [[gnu::cold]] void load(const SlamMap& map) {
    catch_up(Serial{});
    const Index known = to_index(graph_.map().closures.size());
    withdraw();
    in_session_ = false;
    graph_.load(map);
    connect_closures(closure_graph_, graph_.map(), known);
    part();
  }

  /// Keyframes added from now on are of a new session. Without a call, the first keyframe begins one without a name.
  /// Does first what the session before has put off.
  template <Executor E = Serial>
  [[gnu::cold]] void begin_session(std::string name, const E& executor = {});

  /// Takes the next keyframe of the session, tries to close loops with it and to join its frame with others, and
  /// optimizes if that succeeds, or later if it changes little.
  /// @returns its id.
  /// @throws std::invalid_argument if its time is not later than the session's last, or if T_odom_body is not finite;
  /// the map is then as it was.
  template <Executor E = Serial>
  [[gnu::cold]] KeyframeId add(Keyframe keyframe, const E& executor = {});

  /// Takes the session's next frames, keyframes or not, which the map keeps; those up to a keyframe before it.
  /// @throws std::invalid_argument if times do not increase or something is not finite.
  [[gnu::cold]] void add(std::span<const FrameRecord> frames) {
    if (!in_session_) begin_session({});
    graph_.append(frames);
  }
  /// Takes a GNSS fix, which keyframes around its time get a position from; they may then join two frames.
  template <Executor E = Serial>
  [[gnu::cold]] void add(const GnssFix& fix, const E& executor = {}) {
    std::vector<KeyframeFix> fixes;
    gnss_.add(fix, [&](KeyframeId id, const GnssFix& interpolated) { fixes.push_back({id, interpolated}); });
    add(std::span<const KeyframeFix>(fixes), executor);
  }
  /// Takes what one fix gave to keyframes, as the one before does.
  template <Executor E = Serial>
  [[gnu::cold]] void add(std::span<const KeyframeFix> fixes, const E& executor = {});

  /// Optimizes to the end and hands out the map.
  template <Executor E = Serial>
  [[nodiscard]] [[gnu::cold]] std::shared_ptr<const SlamMap> finish(const E& executor = {}) {
    conclude(executor);
    return snapshot();
  }
  /// As `finish`, but gives the map away, at no cost of memory: nothing can be added any more.
  template <Executor E = Serial>
  [[nodiscard]] [[gnu::cold]] std::shared_ptr<const SlamMap> release(const E& executor = {}) {
    conclude(executor);
    return graph_.release();
  }

  /// The map as it is; owned by the back end, to be read on the thread that adds.
  [[nodiscard]] const SlamMap& map() const { return graph_.map(); }
  /// The map as it is between two steps; a copy of what has changed since the last call, made on the calling thread.
  [[nodiscard]] std::shared_ptr<const SlamMap> snapshot() const { return graph_.snapshot(); }
  /// Where odometry's frame lies in the map, by the newest keyframe; null before the first.
  [[nodiscard]] std::shared_ptr<const SE3d> T_map_odom() const { return T_map_odom_.load(); }

  [[nodiscard]] const auto& smoother() const { return graph_.smoother(); }            ///< the smoother behind the map
  [[nodiscard]] const ClosureGraph& closure_graph() const { return closure_graph_; }  ///< of accepted closures
  [[nodiscard]] const Closer& closer() const { return closer_; }                      ///< what finds closures
  [[nodiscard]] const BackEndCounts& counts() const { return counts_; }               ///< what was done so far

 private:
  [[nodiscard]] const Session& session() const { return map().sessions.back(); }
  [[nodiscard]] const Keyframe& keyframe(KeyframeId id) const {
    return map().keyframes[static_cast<std::size_t>(id.value)];
  }

  /// The session ends: what still waits for confirmation gets none.
  [[gnu::cold]] void withdraw() {
    for (const LoopClosure& closure : merger_.withdraw()) graph_.refuse(closure);
  }

  /// Enters all keyframes again: after frames or everything in them have changed.
  [[gnu::cold]] void index_positions() {
    positions_.rebuild(map().keyframes, [&](const Keyframe& one) { return graph_.frame(one) == session().frame; });
    for (detail::Recheck& one : rechecks_) one.moved_all();
  }
  /// Those that an optimization has moved.
  [[gnu::cold]] void index_moved() {
    for (const Key key : graph_.moved()) {
      const Keyframe& moved = keyframe(KeyframeId{key});
      positions_.move(moved.id, moved.T_map_body.translation());
      for (detail::Recheck& one : rechecks_) one.move(moved);
    }
  }

  /// Takes what a search tried into the map, and what chaining finds from it.
  /// @param cause  the closure that made the search, -1 if none.
  /// @returns whether anything was accepted.
  template <Executor E>
  [[gnu::cold]] bool take(std::vector<LoopClosure> tried, Index cause, bool chain, const E& executor);

  /// @param chain  whether to look for more from it. @returns its position among the map's closures.
  template <Executor E>
  Index take(LoopClosure closure, bool chain, const E& executor);

  /// What chaining finds from a closure; its information is shared out.
  template <Executor E>
  [[gnu::cold]] std::vector<LoopClosure> chain_from(LoopClosure& direct, const E& executor) {
    const Index loaded = session().first_keyframe;
    if constexpr (requires {
                    chainer_.close(map().keyframes, closure_graph_, direct, loaded, closer_, executor, &positions_);
                  })
      return chainer_.close(map().keyframes, closure_graph_, direct, loaded, closer_, executor, &positions_);
    else
      return chainer_.close(map().keyframes, closure_graph_, direct, loaded, closer_, executor);
  }

  [[nodiscard]] bool may_close() const {
    return options_.close_before_merge || session().id == SessionId{0} || session().frame != session().id;
  }

  /// Looks for `query` in sessions of other frames, and joins the frames if it is found.
  template <Executor E>
  [[gnu::cold]] void try_merge(KeyframeId query, const E& executor);

  /// Withdraws closures with all that they led to, and parts frames that nothing holds together any more.
  /// @returns whether anything changed.
  [[gnu::cold]] bool part(std::span<const Index> withdrawn = {}) {
    if (!graph_.part(withdrawn)) return false;
    ++counts_.reverted;
    closure_graph_ = ClosureGraph();
    connect_closures(closure_graph_, map(), 0);
    std::erase_if(rechecks_, [&](const detail::Recheck& one) { return one.is_reverted(map()); });
    index_positions();
    optimize();
    return true;
  }

  /// Joins the frames that `closures` connect, by the newest of them, and searches along the aligned session again. If
  /// they are one, what the closures and the fixes contradict is reverted first.
  template <Executor E>
  [[gnu::cold]] void merge(const std::vector<LoopClosure>& closures, const E& executor);

  /// Direct and chained closures of the current session with those that have come into its frame.
  template <Executor E>
  [[gnu::cold]] void recheck(const E& executor);

  /// Whether the keyframe at hand has caused as many alignments as it may.
  [[nodiscard]] bool spent() const { return counts_.alignments >= alignments_end_; }
  void allow(Index more) { alignments_end_ = more > 0 ? counts_.alignments + more : std::numeric_limits<Index>::max(); }
  /// Does all that was put off.
  template <Executor E>
  [[gnu::cold]] void catch_up(const E& executor) {
    if constexpr (requires { merger_.is_unfinished(); })
      while (in_session_ && merger_.is_unfinished()) try_merge(map().keyframes.back().id, executor);
    allow(0);
    if (in_session_) recheck(executor);
    if (in_session_) search_moved(executor);
    if (!waiting_.empty()) optimize();
  }

  /// Tries keyframes of the current session again that have been moved far since they were tried.
  template <Executor E>
  [[gnu::cold]] void search_moved(const E& executor) {
    if constexpr (requires { closer_.search(map().keyframes, positions_, KeyframeId{}, executor); }) {
      if (!(options_.search_again > 0) || !may_close()) return;
      moved_.begin_pass(options_.recheck_travel);
      while (!spent()) {
        const auto id = moved_.next(map().keyframes, session(), options_.search_again, options_.recheck_travel);
        if (!id) return;
        take(closer_.search(map().keyframes, positions_, *id, executor), -1, true, executor);
        if (is_due()) optimize();
      }
    }
  }

  [[nodiscard]] bool is_due() const { return waiting_.are_due(options_.closures_at_once); }
  [[gnu::cold]] void optimize() {
    count_optimization((counts_.last = graph_.optimize()).ok());
    index_moved();
  }
  [[gnu::cold]] void count_optimization(bool succeeded) {
    waiting_.clear();
    ++counts_.optimizations;
    counts_.failed_optimizations += succeeded ? 0 : 1;
  }
  [[gnu::cold]] void publish_frame() {
    if (map().keyframes.empty()) return;
    const Keyframe& newest = map().keyframes.back();
    T_map_odom_.store(std::make_shared<const SE3d>(newest.T_map_body * newest.T_odom_body.inverse()));
  }
  /// What optimizes all at once takes memory that the closer hardly needs any more.
  void free_submaps() {
    if constexpr (requires { closer_.free_submaps(); }) closer_.free_submaps();
  }

  /// Optimizes to the end.
  template <Executor E>
  [[gnu::cold]] void conclude(const E& executor) {
    catch_up(executor);
    withdraw();
    if (!map().closures.empty()) {
      free_submaps();
      counts_.end = graph_.converge(executor);
      const Index optimizations = counts_.optimizations;
      catch_up(executor);  // with what has moved
      free_submaps();
      if (counts_.optimizations != optimizations) counts_.end = graph_.converge(executor);
      if (part()) counts_.end = graph_.converge(executor);
      count_optimization(counts_.end.ok());
      index_positions();
    }
    publish_frame();
  }

  BackEndOptions options_;
  Closer closer_;
  [[no_unique_address]] Chainer chainer_;
  [[no_unique_address]] Merger merger_;
  MapGraph<Outliers> graph_;
  RelativeCovariance<MapGraph<Outliers>> covariance_{graph_};
  ClosureGraph closure_graph_;
  PositionIndex positions_;
  GnssInterpolator gnss_;
  detail::MovedKeyframes moved_;
  detail::WaitingClosures waiting_;
  std::vector<detail::Recheck> rechecks_;  ///< of the current session, in their order
  bool in_session_ = false;
  Index held_after_ = 0;  ///< optimizations until it was last looked whether frames hold together
  BackEndCounts counts_;
  Index alignments_end_ = 0;  ///< of `counts_`, what the keyframe at hand may bring them to
  Snapshot<SE3d> T_map_odom_;
};

template <class Closer, class Chainer, class Merger, class Outliers>
template <Executor E>
void BackEnd<Closer, Chainer, Merger, Outliers>::begin_session(std::string name, const E& executor) {
  catch_up(executor);
  withdraw();
  moved_.begin_session();
  gnss_ = GnssInterpolator();  // the clocks of two drives have nothing in common
  graph_.begin_session(std::move(name));
  in_session_ = true;
  index_positions();
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
  if (may_close()) take(closer_.close(map().keyframes, positions_, executor), -1, true, executor);
  // Where the last one failed, fixes do not make the next one better.
  if (is_due() || graph_.is_unfinished() || (graph_.waiting_fixes() >= options_.fixes_at_once && counts_.last.ok()))
    optimize();
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
  if (chain) chained = chain_from(closure, executor);
  counts_.alignments += to_index(chained.size());
  waiting_.add(map().keyframes, closure, options_.small_correction);
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

}  // namespace chainslam

// Bodies of its members.
#include "chainslam/slam/detail/back_end_merges.hpp"

#ifdef CHAINSLAM_COMPILED
namespace chainslam {

extern template class BackEnd<>;
extern template KeyframeId BackEnd<>::add(Keyframe, const Serial&);
extern template void BackEnd<>::add(const GnssFix&, const Serial&);
extern template KeyframeId BackEnd<>::add(Keyframe, const ThreadPool&);
extern template void BackEnd<>::add(const GnssFix&, const ThreadPool&);
extern template void BackEnd<>::begin_session(std::string, const Serial&);
extern template void BackEnd<>::begin_session(std::string, const ThreadPool&);
extern template std::shared_ptr<const SlamMap> BackEnd<>::finish(const Serial&);
extern template std::shared_ptr<const SlamMap> BackEnd<>::finish(const ThreadPool&);
extern template std::shared_ptr<const SlamMap> BackEnd<>::release(const Serial&);
extern template std::shared_ptr<const SlamMap> BackEnd<>::release(const ThreadPool&);

}  // namespace chainslam
#endif
