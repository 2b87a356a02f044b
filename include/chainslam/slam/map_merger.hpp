#pragma once

#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/map/slam_map.hpp"
#include "chainslam/map/submap.hpp"
#include "chainslam/registration/feature_registration.hpp"
#include "chainslam/slam/chained_closer.hpp"
#include "chainslam/slam/closure_covariance.hpp"
#include "chainslam/slam/fix_evidence.hpp"
#include "chainslam/slam/gnss_candidates.hpp"

namespace chainslam {

/// What measures a merge's closure, once the submaps lie on each other.
enum class MergeMeasurement {
  refined,  ///< alignment of the scan to the submap, which must accept the place too
  submaps,  ///< the registration of the submaps itself: the paper's alignment factor
  scan,     ///< the scan to the submap (released); if that refuses, the frames are joined without a measurement
};

struct MergeOptions {
  bool enabled = true;
  double min_travel = 4.0;  ///< metres along the path between two attempts
  double min_period = 0;    ///< seconds of the data between two attempts
  /// Keyframes n: up to 2n+1 of the earlier session, n+1 of the current one, which has no future.
  Index submap_radius = 20;
  double submap_length = 60;  ///< metres along the path on each side, at most; 0: any (the paper)
  double voxel_size = 1.0;    ///< metres, of both submaps
  /// Inliers over target points (tau_R), and over matched features, of a registration that did not verify its pose. Of
  /// half submaps of four real sensors sought in whole ones, 101 of 102 right poses meet both, and none of 474 wrong
  /// ones.
  double min_fitness = 0.30;
  double min_putative = 0.05;
  double min_source_fitness = 0;  ///< inliers over source points (released: 0.5, by Open3D 0.15.1, which it builds)
  double min_translation = 0;     ///< metres and
  double min_rotation = 0;  ///< radians: frames that lie nearer together than both are not joined (released: 1, 0.035)
  MergeMeasurement measurement = MergeMeasurement::refined;
  double lambda = 1e-4;  ///< of `submaps`: variance, m^2 and rad^2, over the inliers' mean squared distance (the paper)
  Index confirmations = 2;         ///< places that have to agree before the frames are joined (the paper: 1)
  double apart = 10.0;             ///< metres along the path between two such places
  double agree_translation = 2.0;  ///< metres that two places may differ by,
  double agree_per_metre = 0.02;   ///< and metres for each metre of the path between them
  double agree_rotation = 0.1;     ///< radians
  /// What fixes contradict is not joined; and one place is enough if they agree with it, each session along its whole
  /// way, and so many scans around the place do, a quarter as far off as two places may be. 0: one place never is.
  FixEvidenceOptions fixes{};
  Index witnesses = 3;
};

/// Joins the current session's frame with those of earlier ones: place recognition, registration of submap to submap
/// without a guess, and a check (section 6 of the paper).
///
/// A place that passes is a hypothesis, until as many others as asked for agree with it, or the fixes and scans around
/// it do. Hypotheses of different frames stand side by side; those of a frame that was joined otherwise are given up.
/// Keyframes of the session's own frame are tried, too, where fixes say that it lies wrong there.
/// @tparam Candidates    which keyframes to try.
/// @tparam Registration  aligns submaps from nothing.
template <class Candidates = GnssCandidates, class Registration = FeatureRegistration<>>
class MapMerger {
  static_assert(MergeCandidates<Candidates>,
                "MapMerger: Candidates needs `std::vector<KeyframeId> find(map, query)`, as in GnssCandidates");
  static_assert(GlobalRegistration<Registration, PointCloud<float>, PointCloud<float>>,
                "MapMerger: Registration needs `GlobalAlignResult align(source, target, executor) const`, as in "
                "FeatureRegistration");

 public:
  [[gnu::cold]] explicit MapMerger(const MergeOptions& options = {}, Candidates candidates = Candidates{},
                                   Registration registration = Registration{})
      : options_(options),
        candidates_(std::move(candidates)),
        registration_(std::move(registration)),
        evidence_(options.fixes) {}

  /// Tries to find `query`, of the current session, in earlier sessions of other frames.
  ///
  /// @param closer  refines, and so confirms, what registration found.
  /// @returns what was tried. Accepted closures, of kind merge, agree with each other and join two frames: the newest
  /// comes last. If it is one frame, they contradict `contradicted`. Those that wait for others to agree with them are
  /// not among them: see `withdraw`.
  template <ClosureAligner Closer, Executor E = Serial>
  [[nodiscard]] [[gnu::cold]] std::vector<LoopClosure> attempt(const SlamMap& map, KeyframeId query, Closer& closer,
                                                               const E& executor = {});

  /// Gives up what waits for confirmation: at the session's end. @returns it as refusals.
  [[nodiscard]] [[gnu::cold]] std::vector<LoopClosure> withdraw();

  /// Positions of closures that hold sessions together where their fixes contradict it.
  [[nodiscard]] [[gnu::cold]] detail::Table<Index> contradicted(const SlamMap& map) const {
    return contradicted_closures(map, evidence_);
  }

  [[nodiscard]] const MergeOptions& options() const { return options_; }

 private:
  struct Hypothesis {
    LoopClosure closure;
    double travelled = 0;      ///< metres from the session's start to `closure.to`
    bool needs_others = false;  ///< too few scans around it agree
  };
  /// Length of the session's path up to a keyframe.
  struct Path {
    KeyframeId to;
    double length = 0;
  };

  [[nodiscard]] static const Keyframe& keyframe(const SlamMap& map, KeyframeId id) {
    return map.keyframes[static_cast<std::size_t>(id.value)];
  }
  [[nodiscard]] static SessionId frame(const SlamMap& map, KeyframeId id) {
    return map.sessions[static_cast<std::size_t>(keyframe(map, id).session.value)].frame;
  }

  /// Queries come in order.
  [[nodiscard]] [[gnu::cold]] double travelled_to(const SlamMap& map, KeyframeId query);

  template <class Closer, Executor E>
  [[nodiscard]] [[gnu::cold]] LoopClosure register_submaps(const SlamMap& map, KeyframeId from, KeyframeId to,
                                                           Closer& closer, const E& executor) const;

  [[nodiscard]] [[gnu::cold]] ClosureVerdict judge(const SlamMap& map, const LoopClosure& closure,
                                                   const GlobalAlignResult& result) const;

  /// Whom to try, those last that lie in the session's frame although fixes contradict it.
  [[nodiscard]] [[gnu::cold]] std::vector<KeyframeId> candidates(const SlamMap& map, KeyframeId query);

  /// What the fixes of both sides say, if the closure is right: of two frames, or of two sessions of one.
  [[nodiscard]] [[gnu::cold]] FixVerdict ask_fixes(const SlamMap& map, const LoopClosure& closure) const;

  /// If enough hypotheses agree with the newest, settles them.
  /// @returns whether they join two frames.
  [[nodiscard]] [[gnu::cold]] bool confirm(const SlamMap& map, std::vector<LoopClosure>& tried);

  /// If a hypothesis needs no other, settles it.
  template <class Closer, Executor E>
  [[gnu::cold]] void confirm_alone(const SlamMap& map, std::vector<LoopClosure>& tried, Closer& closer,
                                   const E& executor);
  /// Whether enough scans around a place lie where it puts them.
  template <class Closer, Executor E>
  [[nodiscard]] [[gnu::cold]] bool is_witnessed(const SlamMap& map, const LoopClosure& closure, Closer& closer,
                                                const E& executor) const;

  /// Moves to `tried` what is decided: hypotheses of the same frame that do not agree, as refusals, then those that
  /// agree, accepted unless there is something against all of them. Those of other frames go on waiting.
  [[gnu::cold]] void settle(const SlamMap& map, const detail::Table<char>& agreeing, ClosureVerdict verdict,
                            std::vector<LoopClosure>& tried);

  /// Whether two places put the newer of them at the same pose, as far as the paths between them can be trusted.
  [[nodiscard]] [[gnu::cold]] bool agree(const SlamMap& map, const Hypothesis& a, const Hypothesis& b) const;

  /// Carries the current session's frame over into the other one's: x_j T_j_i x_i^-1.
  [[nodiscard]] static SE3d T_frame_joined(const SlamMap& map, const LoopClosure& closure) {
    return keyframe(map, closure.from).T_map_body * closure.T_from_to * keyframe(map, closure.to).T_map_body.inverse();
  }

  MergeOptions options_;
  Candidates candidates_;
  [[no_unique_address]] Registration registration_;
  FixEvidence evidence_;
  detail::Table<Hypothesis> hypotheses_;
  Path path_;
  double last_attempt_ = -std::numeric_limits<double>::infinity();  ///< metres from the session's start
  double last_asked_ = -std::numeric_limits<double>::infinity();    ///< whether one place is enough, the same
  std::optional<Timestamp> last_time_;
};

template <class Candidates, class Registration>
template <ClosureAligner Closer, Executor E>
std::vector<LoopClosure> MapMerger<Candidates, Registration>::attempt(const SlamMap& map, KeyframeId query,
                                                                      Closer& closer, const E& executor) {
  std::vector<LoopClosure> tried;
  if (!options_.enabled) return tried;
  const double travelled = travelled_to(map, query);
  const double since = travelled - last_attempt_;
  if (since < options_.min_travel || since <= 0) return tried;  // asked again at the same place: nothing new to see
  const Timestamp now = keyframe(map, query).time;
  if (last_time_ && to_seconds(now - *last_time_) < options_.min_period) return tried;
  for (const KeyframeId candidate : candidates(map, query)) {
    last_attempt_ = travelled;
    last_time_ = now;
    LoopClosure closure = register_submaps(map, candidate, query, closer, executor);
    if (closure.verdict != ClosureVerdict::accepted) {
      tried.push_back(closure);
      continue;
    }
    hypotheses_.push_back({closure, travelled});
    if (confirm(map, tried)) return tried;
    last_asked_ = -std::numeric_limits<double>::infinity();
  }
  if (travelled - last_asked_ >= options_.apart) {
    last_asked_ = travelled;
    confirm_alone(map, tried, closer, executor);
  }
  return tried;
}

template <class Candidates, class Registration>
std::vector<KeyframeId> MapMerger<Candidates, Registration>::candidates(const SlamMap& map, KeyframeId query) {
  std::vector<KeyframeId> found = candidates_.find(map, query);
  if constexpr (requires { candidates_.misplaced(map, query); }) {
    LoopClosure as_it_is{.to = query};
    for (const KeyframeId id : candidates_.misplaced(map, query)) {
      as_it_is.from = id;
      as_it_is.T_from_to = keyframe(map, id).T_map_body.inverse() * keyframe(map, query).T_map_body;
      if (ask_fixes(map, as_it_is) == FixVerdict::contradict) found.push_back(id);
    }
  }
  return found;
}

template <class Candidates, class Registration>
FixVerdict MapMerger<Candidates, Registration>::ask_fixes(const SlamMap& map, const LoopClosure& closure) const {
  const SessionId there = frame(map, closure.from), here = frame(map, closure.to);
  const SessionId from = keyframe(map, closure.from).session, to = keyframe(map, closure.to).session;
  const auto is = [&](const Session& one, SessionId session, SessionId of) {
    return there == here ? one.id == session : one.frame == of;
  };
  return evidence_(
      map, [&](const Session& one) { return is(one, from, there); },
      [&](const Session& one) { return is(one, to, here); }, T_frame_joined(map, closure));
}

template <class Candidates, class Registration>
std::vector<LoopClosure> MapMerger<Candidates, Registration>::withdraw() {
  std::vector<LoopClosure> refused;
  for (Hypothesis& hypothesis : hypotheses_) {
    hypothesis.closure.verdict = ClosureVerdict::unconfirmed;
    refused.push_back(hypothesis.closure);
  }
  hypotheses_.clear();
  path_ = {};
  last_attempt_ = last_asked_ = -std::numeric_limits<double>::infinity();
  last_time_.reset();
  return refused;
}

template <class Candidates, class Registration>
double MapMerger<Candidates, Registration>::travelled_to(const SlamMap& map, KeyframeId query) {
  if (!path_.to.valid() || keyframe(map, path_.to).session != keyframe(map, query).session) path_ = {query, 0};
  for (; path_.to < query; ++path_.to.value)
    path_.length +=
        (keyframe(map, path_.to).T_odom_body.inverse() * keyframe(map, KeyframeId{path_.to.value + 1}).T_odom_body)
            .translation()
            .norm();
  return path_.length;
}

template <class Candidates, class Registration>
template <class Closer, Executor E>
LoopClosure MapMerger<Candidates, Registration>::register_submaps(const SlamMap& map, KeyframeId from, KeyframeId to,
                                                                  Closer& closer, const E& executor) const {
  SubmapRange current = submap_range(map.keyframes, to, options_.submap_radius, options_.submap_length);
  current.end = to.value + 1;
  const auto source = assemble_submap(map.keyframes, to, current, options_.voxel_size);
  const auto target = assemble_submap(map.keyframes, from,
                                      submap_range(map.keyframes, from, options_.submap_radius, options_.submap_length),
                                      options_.voxel_size);
  const GlobalAlignResult result = registration_.align(source, target, executor);
  LoopClosure closure{.from = from, .to = to, .T_from_to = result.T_target_source, .kind = ClosureKind::merge};
  closure.verdict = judge(map, closure, result);
  closure.inlier_ratio = result.fitness_target;
  closure.mean_squared_error = result.inlier_rmse * result.inlier_rmse;
  if (closure.verdict != ClosureVerdict::accepted) return closure;
  if (options_.measurement == MergeMeasurement::submaps) {
    closure.sqrt_information =
        NoiseModel<6>::from_covariance(IsotropicCovariance{.lambda = options_.lambda}(closure.mean_squared_error))
            .sqrt_information();
    return closure;
  }
  LoopClosure refined = closer.align(map.keyframes, from, to, closure.T_from_to, executor);
  if (options_.measurement == MergeMeasurement::scan && refined.verdict != ClosureVerdict::accepted) return closure;
  refined.kind = ClosureKind::merge;
  refined.inlier_ratio = result.fitness_target;
  return refined;
}

template <class Candidates, class Registration>
ClosureVerdict MapMerger<Candidates, Registration>::judge(const SlamMap& map, const LoopClosure& closure,
                                                          const GlobalAlignResult& result) const {
  if (result.status == GlobalAlignStatus::refused) return ClosureVerdict::high_residual;
  if (!result.found()) return ClosureVerdict::not_converged;
  if (!result.verified &&
      !(result.fitness_target >= options_.min_fitness && result.putative_ratio >= options_.min_putative &&
        result.fitness_source >= options_.min_source_fitness))
    return ClosureVerdict::low_fitness;
  const SE3d T = T_frame_joined(map, closure);
  const bool same_frame =
      T.translation().norm() < options_.min_translation && T.rotation().log().norm() < options_.min_rotation;
  return same_frame ? ClosureVerdict::implausible : ClosureVerdict::accepted;
}

template <class Candidates, class Registration>
bool MapMerger<Candidates, Registration>::confirm(const SlamMap& map, std::vector<LoopClosure>& tried) {
  const Hypothesis newest = hypotheses_.back();
  detail::Table<char> agreeing;
  Index count = 0;
  double last = -std::numeric_limits<double>::infinity();
  for (const Hypothesis& one : hypotheses_) {
    const bool is_newest = &one == &hypotheses_.back();
    const bool apart = one.travelled - last >= options_.apart && newest.travelled - one.travelled >= options_.apart;
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

template <class Candidates, class Registration>
template <class Closer, Executor E>
void MapMerger<Candidates, Registration>::confirm_alone(const SlamMap& map, std::vector<LoopClosure>& tried,
                                                        Closer& closer, const E& executor) {
  for (Hypothesis& one : hypotheses_) {
    if (options_.witnesses <= 0 || one.needs_others || ask_fixes(map, one.closure) != FixVerdict::agree) continue;
    if (!is_witnessed(map, one.closure, closer, executor)) {
      one.needs_others = path_.length - one.travelled >= options_.apart;  // else there are scans to come
      continue;
    }
    detail::Table<char> agreeing;
    for (const Hypothesis& other : hypotheses_) agreeing.push_back(&other == &one ? 1 : 0);
    settle(map, agreeing, ClosureVerdict::accepted, tried);
    return;
  }
}

template <class Candidates, class Registration>
template <class Closer, Executor E>
bool MapMerger<Candidates, Registration>::is_witnessed(const SlamMap& map, const LoopClosure& closure, Closer& closer,
                                                       const E& executor) const {
  constexpr double share = 0.25;  // of what two places may differ by
  const Session& session = map.sessions[static_cast<std::size_t>(keyframe(map, closure.to).session.value)];
  Index agreeing = 0;
  for (Index step = 1; step <= options_.witnesses; ++step)
    for (const Index near : {closure.to.value - step, closure.to.value + step}) {
      if (near < session.first_keyframe || near >= session.end_keyframe()) continue;
      const SE3d T_to_near = keyframe(map, closure.to).T_map_body.inverse() * keyframe(map, KeyframeId{near}).T_map_body;
      const SE3d guess = closure.T_from_to * T_to_near;
      const LoopClosure seen = closer.align(map.keyframes, closure.from, KeyframeId{near}, guess, executor);
      const SE3d off = guess.inverse() * seen.T_from_to;
      if (seen.verdict == ClosureVerdict::accepted && off.translation().norm() <= share * options_.agree_translation &&
          off.rotation().log().norm() <= share * options_.agree_rotation)
        ++agreeing;
    }
  return agreeing >= options_.witnesses;
}

template <class Candidates, class Registration>
void MapMerger<Candidates, Registration>::settle(const SlamMap& map, const detail::Table<char>& agreeing,
                                                 ClosureVerdict verdict, std::vector<LoopClosure>& tried) {
  detail::Table<Hypothesis> waiting;
  std::vector<LoopClosure> others, decided;
  SessionId joined;
  for (Offset k = 0; k < hypotheses_.size(); ++k)
    if (agreeing[k] != 0) joined = frame(map, hypotheses_[k].closure.from);
  for (Offset k = 0; k < hypotheses_.size(); ++k) {
    LoopClosure closure = hypotheses_[k].closure;
    if (agreeing[k] != 0) {
      closure.verdict = verdict;
      decided.push_back(closure);
    } else if (verdict == ClosureVerdict::accepted && frame(map, closure.from) == joined) {
      closure.verdict = ClosureVerdict::unconfirmed;
      others.push_back(closure);
    } else {
      waiting.push_back(hypotheses_[k]);
    }
  }
  for (const auto& list : {&others, &decided})
    for (const LoopClosure& closure : *list) tried.push_back(closure);
  hypotheses_ = std::move(waiting);
}

template <class Candidates, class Registration>
bool MapMerger<Candidates, Registration>::agree(const SlamMap& map, const Hypothesis& a, const Hypothesis& b) const {
  if (frame(map, a.closure.from) != frame(map, b.closure.from)) return false;
  const SE3d& here = keyframe(map, b.closure.to).T_map_body;
  const SE3d difference = (T_frame_joined(map, a.closure) * here).inverse() * (T_frame_joined(map, b.closure) * here);
  const double path = b.travelled - a.travelled;
  return difference.translation().norm() <= options_.agree_translation + options_.agree_per_metre * path &&
         difference.rotation().log().norm() <= options_.agree_rotation;
}

/// Joins no frames: every session stays by itself.
struct NoMerging {
  template <class Closer, Executor E = Serial>
  [[nodiscard]] std::vector<LoopClosure> attempt(const SlamMap& /*map*/, KeyframeId /*query*/, Closer& /*closer*/,
                                                 const E& /*executor*/ = {}) const {
    return {};
  }
  [[nodiscard]] std::vector<LoopClosure> withdraw() const { return {}; }
};

}  // namespace chainslam
