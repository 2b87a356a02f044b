#include "mapping.hpp"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <future>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <thread>
#include <utility>
#include <variant>
#include <vector>

#include "chainslam/slam/back_end.hpp"
#include "chainslam/slam/keyframe_selector.hpp"
#include "chainslam/slam/map_undo.hpp"
#include "chainslam/slam/pipeline.hpp"
#include "chainslam/slam/place_candidates.hpp"
#include "chainslam/slam/proximity_or_places.hpp"
#include "session_front_end.hpp"
#include "support/frame_health.hpp"
#include "support/summary.hpp"

namespace chainslam::mapper {

namespace {

using Closer = LoopCloser<ProximityOrPlaces, ClosureRegistration, ClosureNoise>;
using Merger = MapMerger<GnssOrPlaces<>, MergeRegistration>;
using MapperBackEnd = BackEnd<Unrepeated<Closer>, ChainedCloser, Merger>;

/// @param undone  closures that are not to be found again
MapperBackEnd make_back_end(const BackEndParts& parts, const UndoneClosures& undone = {}) {
  PlaceCandidateOptions within = parts.places;
  within.max_count = parts.closure_places;
  within.max_drawn = 2;  // asked for each search
  Closer closer(parts.closures, ProximityOrPlaces(parts.candidates, PlaceCandidates(within)), parts.registration,
                parts.noise);
  Merger merger(parts.merge, GnssOrPlaces(GnssCandidates(parts.gnss), PlaceCandidates(parts.places)), parts.merging);
  merger.forbid(undone);
  return MapperBackEnd(parts.back_end, {std::move(closer), undone}, ChainedCloser(parts.chain), std::move(merger),
                       parts.outliers);
}

/// The back end with a clock, and with figures that the front end's thread may read.
class MeteredBackEnd {
 public:
  MeteredBackEnd(MapperBackEnd& back_end, const MappingRun& run) : back_end_(back_end), run_(run) {}

  /// What the session before has put off is done first.
  template <Executor E>
  void begin_session(std::string name, const E& executor) {
    const auto measurement = run_.times.measure("end of session");
    back_end_.begin_session(std::move(name), executor);
  }

  template <Executor E>
  KeyframeId add(Keyframe keyframe, const E& executor) {
    const Index before = back_end_.counts().alignments;
    KeyframeId id;
    measured([&] { id = back_end_.add(std::move(keyframe), executor); });
    figures_.keyframe_seconds.push_back(seconds_);
    figures_.keyframe_alignments.push_back(back_end_.counts().alignments - before);
    run_.times.add("back end", seconds_);
    publish();
    return id;
  }
  /// A fix may join two sessions: that work counts to the keyframe before it.
  template <Executor E>
  void add(const GnssFix& fix, const E& executor) {
    const Index before = back_end_.counts().alignments;
    measured([&] { back_end_.add(fix, executor); });
    run_.times.add("GNSS fixes", seconds_);
    if (figures_.keyframe_seconds.empty()) return;
    figures_.keyframe_seconds.back() += seconds_;
    figures_.keyframe_alignments.back() += back_end_.counts().alignments - before;
    publish();
  }
  void add(std::span<const FrameRecord> frames) { back_end_.add(frames); }
  template <Executor E>
  void add(std::span<const KeyframeFix> fixes, const E& executor) {
    back_end_.add(fixes, executor);
    publish();
  }

  /// @name For the front end's thread.
  /// @{
  [[nodiscard]] Index keyframes() const { return keyframes_; }
  [[nodiscard]] Index direct_closures() const { return direct_; }
  [[nodiscard]] Index chained_closures() const { return chained_; }
  /// @}

  [[nodiscard]] BackEndFigures figures() const {
    BackEndFigures figures = figures_;
    const BackEndCounts& counts = back_end_.counts();
    figures.alignments = counts.alignments;
    figures.merges = counts.merges;
    figures.optimizations = counts.optimizations;
    figures.failed_optimizations = counts.failed_optimizations;
    figures.closure_radius = run_.options.back_end.candidates.radius;
    figures.search_spacing = back_end_.closer().closer().search_spacing();
    return figures;
  }

 private:
  template <class Work>
  void measured(Work&& work) {
    const auto start = std::chrono::steady_clock::now();
    work();
    seconds_ = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  }

  void publish() {
    const SlamMap& map = back_end_.map();
    for (; counted_ < map.closures.size(); ++counted_)  // a closure stays, and what kind it is of
      ++(map.closures[counted_].kind == ClosureKind::chained ? chained_ : direct_);
    keyframes_ = to_index(map.keyframes.size());
    if (run_.journal) run_.journal(map);
  }

  MapperBackEnd& back_end_;
  const MappingRun& run_;
  BackEndFigures figures_;
  double seconds_ = 0;
  std::size_t counted_ = 0;  ///< closures in the numbers below
  std::atomic<Index> keyframes_ = 0, direct_ = 0, chained_ = 0;
};

using MapperPipeline = Pipeline<MeteredBackEnd, ThreadPool>;

/// Maps one data set: what odometry says of each scan goes to the trajectory, what the selector picks to the back end.
class SessionMapper {
 public:
  SessionMapper(datasets::Dataset& dataset, const MappingRun& run, const ThreadPool& threads,
                const MeteredBackEnd& back_end, MapperPipeline& pipeline)
      : dataset_(dataset),
        run_(run),
        threads_(threads),
        back_end_(back_end),
        pipeline_(pipeline),
        recorded_(dataset.info().has_odometry),
        select_(keyframe_options(dataset.info(), run.options.keyframes)),
        waits_for_clock_(waits_for_clock(dataset.info(), run.options)) {
    state_.stage = stage();
    state_.total = expected_scans(dataset.info(), run.max_scans);
  }

  [[nodiscard]] SessionRun map() {
    waiting_.emplace_back(SessionStart{dataset_.info().name});
    SessionRun session = SessionFrontEnd(dataset_, run_, threads_,
                                         {.fix = [&](const GnssFix& fix) { waiting_.emplace_back(fix); },
                                          .frame = [&](const Frame& frame) { add(frame); },
                                          .scan = [&](const SessionRun& so_far) { show(so_far); },
                                          .retime = [&](double shift) { retime(shift); }})
                             .run();
    complete_ = true;
    pass();
    await_recording();
    show(session);
    return session;
  }

 private:
  /// What is shown is safe: all of recorded odometry, which comes faster than disks sync, else all but the last second;
  /// of a session that waits for its clock, nothing is yet.
  void show(const SessionRun& session) {
    scans_ = session.scans;
    if (recorded_ ? !is_recording() : at_risk() > most_at_risk) await_recording();
    if (!recorded_ && at_risk() > most_at_risk) {
      pass();
      await_recording();
    }
    state_.done = recorded_ ? safe_scans_ : scans_;
    state_.keyframes = back_end_.keyframes();
    state_.direct_closures = back_end_.direct_closures();
    state_.chained_closures = back_end_.chained_closures();
    run_.progress.update(state_);
  }

  void add(const Frame& frame) {
    if (!first_) first_ = safe_ = frame.time;
    last_ = frame.time;
    state_.data_seconds = to_seconds(frame.time - *first_);
    frames_.push_back(record_of(frame));
    auto keyframe = select_(frame);
    if (!keyframe && frame.time - frames_.front().time < most_waiting) return;
    waiting_.emplace_back(std::exchange(frames_, {}));
    if (keyframe) waiting_.emplace_back(std::move(*keyframe));
    pass();
  }

  [[nodiscard]] std::string stage() const {
    return (waits_for_clock_ ? "comparing clocks of " : "mapping ") + dataset_.info().name;
  }

  /// What has waited for its clock has the right times now.
  void retime(double shift) {
    const auto later = [&](Timestamp& time) { time = time + seconds(shift); };
    for (MapInput& input : waiting_) {
      if (auto* keyframe = std::get_if<Keyframe>(&input)) later(keyframe->time);
      if (auto* frames = std::get_if<std::vector<FrameRecord>>(&input))
        for (FrameRecord& frame : *frames) later(frame.time);
    }
    for (FrameRecord& frame : frames_) later(frame.time);
    for (Timestamp* time : {&last_, &passed_, &safe_}) later(*time);
    if (first_) later(*first_);
    waits_for_clock_ = false;
    state_.stage = stage();
  }

  /// What has come goes to the back end, but not before it is safe. While the disk makes it so, odometry goes on: by
  /// one batch, so that no more than two are at risk. Of recorded odometry, batches grow to 16 keyframes or so.
  void pass() {
    if (waits_for_clock_) return;
    if (!frames_.empty()) waiting_.emplace_back(std::exchange(frames_, {}));
    if (recorded_ && waiting_.size() < batch_ && !complete_) return;
    batch_ = std::min(2 * batch_, most_in_batch);
    await_recording();
    passed_ = last_;
    passed_scans_ = scans_;
    recording_ = std::async(std::launch::async, [this, inputs = std::exchange(waiting_, {})]() mutable {
      if (run_.record) run_.record(inputs);
      for (MapInput& input : inputs) pipeline_.push(std::move(input));
    });
  }

  [[nodiscard]] bool is_recording() const {
    return recording_.valid() && recording_.wait_for(std::chrono::seconds(0)) != std::future_status::ready;
  }

  /// @throws what recording or the back end has thrown.
  void await_recording() {
    if (!recording_.valid()) return;
    const auto measurement = run_.times.measure("journal");
    try {
      recording_.get();
    } catch (const IoError& error) {  // also where a scan of the map cannot be read: not for want of data
      throw IoError(IoError::Kind::output, error.report());
    }
    safe_ = passed_;
    safe_scans_ = passed_scans_;
  }

  /// How far odometry is ahead of what no crash loses.
  [[nodiscard]] Duration at_risk() const { return last_ - safe_; }

  static constexpr Duration most_waiting = std::chrono::milliseconds(400), most_at_risk = std::chrono::seconds(1);
  static constexpr std::size_t most_in_batch = 32;  // inputs: a keyframe comes with the frames up to it

  datasets::Dataset& dataset_;
  const MappingRun& run_;
  const ThreadPool& threads_;
  const MeteredBackEnd& back_end_;
  MapperPipeline& pipeline_;
  bool recorded_, complete_ = false;
  std::size_t batch_ = 2;  ///< inputs
  KeyframeSelector select_;
  bool waits_for_clock_;            ///< what comes is kept until then
  std::optional<Timestamp> first_;  ///< time of the first frame,
  Timestamp last_, passed_, safe_;  ///< of the last one, of the last passed on, of the last recorded
  Index scans_ = 0, passed_scans_ = 0, safe_scans_ = 0;  ///< likewise
  std::vector<FrameRecord> frames_;                      ///< that the back end does not have yet,
  std::vector<MapInput> waiting_;                        ///< and what else it gets before these
  support::ProgressState state_;
  std::future<void> recording_;  ///< the batch before
};

/// Shows how the back end catches up with what odometry gave it.
void await(MapperPipeline& pipeline, const MeteredBackEnd& back_end, support::Progress& progress) {
  support::ProgressState state{.stage = "closing loops", .total = to_index(pipeline.backlog())};
  while (const std::size_t backlog = pipeline.backlog()) {
    state.done = state.total - std::min(state.total, to_index(backlog));
    state.keyframes = back_end.keyframes();
    state.direct_closures = back_end.direct_closures();
    state.chained_closures = back_end.chained_closures();
    progress.update(state);
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  pipeline.finish();
}

/// The paper keeps the components of the adjacency graph apart by v / f_lc > r_lc; the chain's own bounds do it too.
std::optional<std::string> spacing_note(const ChainOptions& chain, const BackEndFigures& figures) {
  const support::SearchSpacing spacing = support::search_spacing(figures.search_spacing, figures.closure_radius);
  const bool bounded = chain.max_distance > 0 && chain.max_alignments > 0;
  if (!chain.enabled || bounded || spacing.intervals == 0 || spacing.kept()) return std::nullopt;
  char text[320];
  std::snprintf(text, sizeof text,
                "closures were sought each %.1f m (closures.min_travel, closures.min_period), nearer than they reach "
                "(closures.radius, %.4g m): components of the adjacency graph grow together, and chains with them; see "
                "components in summary.json",
                spacing.mean, spacing.radius);
  return text;
}

/// Gives a back end sessions again, and shows how far that is.
std::shared_ptr<const SlamMap> replay_all(MapperBackEnd& back_end, std::span<const ReplayedSession> sessions,
                                          const char* stage, const MappingRun& run) {
  const auto session_of = [](const ReplayedSession& one) -> const Session& {
    return one.map->sessions[static_cast<std::size_t>(one.session.value)];
  };
  const ThreadPool threads(run.threads);
  MeteredBackEnd metered(back_end, run);
  support::ProgressState state{.stage = stage};
  for (const ReplayedSession& one : sessions) state.total += session_of(one).keyframes;
  for (const ReplayedSession& one : sessions)
    replay(*one.map, session_of(one), metered, threads, [&](KeyframeId) {
      ++state.done;
      state.keyframes = metered.keyframes();
      state.direct_closures = metered.direct_closures();
      state.chained_closures = metered.chained_closures();
      run.progress.update(state);
    });
  auto replayed = back_end.release(threads);
  run.progress.finish();
  return replayed;
}

/// Maps one data set after the other. Their odometry is left out of the result: the map has it, too.
MappingResult map_all(std::span<const std::unique_ptr<datasets::Dataset>> datasets, std::vector<SlamMap> loaded,
                      const MappingRun& run) {
  MapperBackEnd back_end = make_back_end(run.options.back_end);
  for (SlamMap& map : loaded) back_end.load(std::exchange(map, {}));
  MappingResult result;
  const auto first = to_index(back_end.map().sessions.size());
  {
    const ThreadPool threads(run.threads);  // of both ends: now the one has more to do, now the other
    MeteredBackEnd metered(back_end, run);
    MapperPipeline pipeline(metered, threads, {}, 128);  // a keyframe comes with the frames up to it
    for (const auto& dataset : datasets) {
      result.memory_full = memory_is_full(run);
      if (run.stop.stop_requested() || result.memory_full) break;
      SessionRun session = SessionMapper(*dataset, run, threads, metered, pipeline).map();
      session.id = SessionId{first + to_index(result.sessions.size())};
      session.odometry = {};
      result.sessions.push_back(std::move(session));
      result.failure = result.sessions.back().failure;
      result.memory_full = result.sessions.back().memory_full;
      if (result.failure || result.memory_full) break;
    }
    result.memory_full |= memory_is_full(run);
    await(pipeline, metered, run.progress);
    run.progress.update({.stage = "final optimization",
                         .keyframes = metered.keyframes(),
                         .direct_closures = metered.direct_closures(),
                         .chained_closures = metered.chained_closures()});
    const auto measurement = run.times.measure("final optimization");
    result.map = back_end.release(threads);
    result.figures = metered.figures();
  }
  run.progress.finish();
  if (const auto note = spacing_note(run.options.back_end.chain, result.figures)) result.notes.push_back(*note);
  result.interrupted = run.stop.stop_requested() || result.failure || result.memory_full;
  if (result.figures.failed_optimizations > 0)
    result.notes.push_back(std::to_string(result.figures.failed_optimizations) +
                           " optimizations failed; the previous estimates were kept");
  return result;
}

}  // namespace

bool memory_is_full(const MappingRun& run) { return run.max_memory > 0 && support::current_memory() > run.max_memory; }

MappingResult run_mapping(std::span<const std::unique_ptr<datasets::Dataset>> datasets, std::vector<SlamMap> loaded,
                          const MappingRun& run) {
  MappingResult result = map_all(datasets, std::move(loaded), run);
  for (SessionRun& session : result.sessions)  // once the back end's memory is free
    session.odometry = support::odometry_of(result.map->frames.of(session.id));
  return result;
}

std::shared_ptr<const SlamMap> run_again(std::vector<MapInput> inputs, std::vector<SlamMap> loaded,
                                         const MappingRun& run) {
  MapperBackEnd back_end = make_back_end(run.options.back_end);
  for (SlamMap& map : loaded) back_end.load(std::exchange(map, {}));
  const ThreadPool threads(run.threads);
  MeteredBackEnd metered(back_end, run);
  MapperPipeline pipeline(metered, threads);
  support::ProgressState state{.stage = "recovering", .total = to_index(inputs.size())};
  for (MapInput& input : inputs) {
    pipeline.push(std::move(input));
    ++state.done;
    state.keyframes = metered.keyframes();
    run.progress.update(state);
  }
  pipeline.finish();
  run.progress.finish();
  return back_end.release(threads);
}

std::shared_ptr<const SlamMap> map_again(const SlamMap& map, const UndoneClosures& undone, const MappingRun& run) {
  std::vector<ReplayedSession> sessions;
  for (const Session& session : map.sessions) sessions.push_back({&map, session.id});
  MapperBackEnd back_end = make_back_end(run.options.back_end, undone);
  return replay_all(back_end, sessions, "deciding again", run);
}

std::shared_ptr<const SlamMap> map_onto(const SlamMap& first, std::span<const ReplayedSession> sessions,
                                        const MappingRun& run) {
  MapperBackEnd back_end = make_back_end(run.options.back_end);
  if (!first.sessions.empty()) back_end.load(first);
  return replay_all(back_end, sessions, "merging", run);
}

ConvergeReport optimize_map(SlamMap& map, const BackEndParts& parts) {
  return settle(map, parts.back_end.graph, parts.outliers);
}

}  // namespace chainslam::mapper
