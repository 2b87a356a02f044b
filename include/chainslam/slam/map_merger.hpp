#pragma once

#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/registration/feature_registration.hpp"
#include "chainslam/slam/back_end_options.hpp"
#include "chainslam/slam/chained_closer.hpp"
#include "chainslam/slam/closure_descent.hpp"
#include "chainslam/slam/detail/merge_hypotheses.hpp"
#include "chainslam/slam/gnss_candidates.hpp"
#include "chainslam/slam/loop_closer.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "chainslam/slam/submap.hpp"

namespace chainslam {

/// Joins the current session's frame with those of earlier ones: place recognition, registration of submap to submap
/// without a guess, and a check (section 6 of the paper).
///
/// A place that passes is a hypothesis, until as many others as asked for agree with it, or the fixes and scans around
/// it do. Hypotheses of different frames stand side by side; those of a frame that was joined otherwise are discarded.
/// Keyframes of the session's own frame are tried, too, where fixes say that it lies wrong there.
/// @tparam Candidates    which keyframes to try. If they have `std::optional<SE3d> guess(from, to) const`, as
///                       PlaceCandidates do, a candidate with a guess is aligned from it.
/// @tparam Registration  aligns submaps from nothing.
template <class Candidates = GnssCandidates, class Registration = FeatureRegistration<>>
class MapMerger {
  static_assert(MergeCandidates<Candidates>,
                "MapMerger: Candidates needs `std::vector<KeyframeId> find(map, query)`, as in GnssCandidates");
  static_assert(GlobalRegistration<Registration, PointCloud<float>, PointCloud<float>>,
                "MapMerger: Registration needs `GlobalAlignResult align(source, target, executor) const`, as in "
                "FeatureRegistration");

 public:
  /// Starts without merges. Policies are moved in, with their settings.
  [[gnu::cold]] explicit MapMerger(const MergeOptions& options = {}, Candidates candidates = Candidates{},
                                   Registration registration = Registration{})
      : options_(options),
        candidates_(std::move(candidates)),
        registration_(std::move(registration)),
        hypotheses_(options) {}

  /// Tries to find `query`, of the current session, in earlier sessions of other frames.
  ///
  /// @param closer  refines, and so confirms, what registration found.
  /// @returns what was tried. Accepted closures, of kind merge, agree with each other and join two frames: the newest
  /// comes last. If it is one frame, they contradict `contradicted`. Those that wait for others to agree with them are
  /// not among them: see `withdraw`. While candidates of an earlier query wait, these are tried instead.
  template <ClosureAligner Closer, Executor E = Serial>
  [[nodiscard]] [[gnu::cold]] std::vector<LoopClosure> attempt(const SlamMap& map, KeyframeId query, Closer& closer,
                                                               const E& executor = {});

  /// Whether candidates are left that the next attempt tries.
  [[nodiscard]] bool is_unfinished() const { return !pending_.candidates.empty(); }

  /// Discards what waits for confirmation: at the session's end. @returns it as refusals.
  [[nodiscard]] [[gnu::cold]] std::vector<LoopClosure> withdraw();

  /// Positions of closures that hold sessions together where their fixes contradict it.
  [[nodiscard]] [[gnu::cold]] detail::Table<Index> contradicted(const SlamMap& map) const {
    return hypotheses_.contradicted(map);
  }

  /// From now on, places that repeat these are refused as `reverted`.
  [[gnu::cold]] void forbid(const UndoneClosures& undone) { undone_ = undone; }

  [[nodiscard]] const MergeOptions& options() const { return options_; }  ///< its settings

 private:
  /// Length of the session's path up to a keyframe.
  struct Path {
    KeyframeId to;
    double length = 0;
  };

  /// What of an attempt waits for the next one.
  struct Pending {
    KeyframeId query;
    double travelled = 0;  ///< metres from the session's start to it
    detail::Table<KeyframeId> candidates;
  };

  [[nodiscard]] static const Keyframe& keyframe(const SlamMap& map, KeyframeId id) {
    return map.keyframes[static_cast<std::size_t>(id.value)];
  }

  /// Looks for candidates, if the query lies far enough along the path from the last that had some, and late enough.
  /// @returns whether it does.
  [[nodiscard]] [[gnu::cold]] bool look_for_candidates(const SlamMap& map, KeyframeId query);

  /// Queries come in order.
  [[nodiscard]] [[gnu::cold]] double travelled_to(const SlamMap& map, KeyframeId query);

  template <class Closer, Executor E>
  [[nodiscard]] [[gnu::cold]] LoopClosure register_submaps(const SlamMap& map, KeyframeId from, KeyframeId to,
                                                           Closer& closer, const E& executor) const;

  /// From the guess that came with a candidate: nothing has to be found that a closure's gate would not see.
  template <class Closer, Executor E>
  [[nodiscard]] [[gnu::cold]] LoopClosure align_from(const SlamMap& map, KeyframeId from, KeyframeId to,
                                                     const SE3d& guess, Closer& closer, const E& executor) const;

  [[nodiscard]] [[gnu::cold]] ClosureVerdict judge(const SlamMap& map, const LoopClosure& closure,
                                                   const GlobalAlignResult& result) const;

  /// Whether a closure puts the session's frame where it is already.
  [[nodiscard]] [[gnu::cold]] bool is_same_frame(const SlamMap& map, const LoopClosure& closure) const {
    const SE3d T = detail::T_frame_joined(map, closure);
    return T.translation().norm() < options_.min_translation && T.rotation().log().norm() < options_.min_rotation;
  }

  /// Whom to try, those last that lie in the session's frame although fixes contradict it.
  [[nodiscard]] [[gnu::cold]] std::vector<KeyframeId> candidates(const SlamMap& map, KeyframeId query);

  /// If a hypothesis needs no other, accepts it.
  template <class Closer, Executor E>
  [[gnu::cold]] void confirm_alone(const SlamMap& map, std::vector<LoopClosure>& tried, Closer& closer,
                                   const E& executor);
  /// Whether enough scans around a place lie where it puts them.
  template <class Closer, Executor E>
  [[nodiscard]] [[gnu::cold]] bool is_witnessed(const SlamMap& map, const LoopClosure& closure, Closer& closer,
                                                const E& executor) const;

  MergeOptions options_;
  Candidates candidates_;
  [[no_unique_address]] Registration registration_;
  detail::MergeHypotheses hypotheses_;
  UndoneClosures undone_;
  Path path_;
  Pending pending_;
  double last_attempt_ = -std::numeric_limits<double>::infinity();  ///< metres from the session's start
  double last_asked_ = -std::numeric_limits<double>::infinity();    ///< whether one place is enough, the same
  std::optional<Timestamp> last_time_;
};

template <class Candidates, class Registration>
template <ClosureAligner Closer, Executor E>
std::vector<LoopClosure> MapMerger<Candidates, Registration>::attempt(const SlamMap& map, KeyframeId query,
                                                                      Closer& closer, const E& executor) {
  std::vector<LoopClosure> tried;
  if (!options_.enabled || (pending_.candidates.empty() && !look_for_candidates(map, query))) return tried;
  for (Index count = 0; !pending_.candidates.empty(); ++count) {
    if (options_.max_registrations > 0 && count >= options_.max_registrations) return tried;
    const KeyframeId candidate = pending_.candidates.back();
    pending_.candidates.pop_back();
    LoopClosure closure = register_submaps(map, candidate, pending_.query, closer, executor);
    undone_.refuse_repeated_merge(map, options_, closure);
    if (closure.verdict != ClosureVerdict::accepted) {
      tried.push_back(closure);
      continue;
    }
    hypotheses_.add(closure, pending_.travelled);
    if (hypotheses_.confirm(map, tried)) {
      pending_ = {};
      return tried;
    }
    last_asked_ = -std::numeric_limits<double>::infinity();
  }
  if (pending_.travelled - last_asked_ >= options_.min_place_distance) {
    last_asked_ = pending_.travelled;
    confirm_alone(map, tried, closer, executor);
  }
  return tried;
}

template <class Candidates, class Registration>
bool MapMerger<Candidates, Registration>::look_for_candidates(const SlamMap& map, KeyframeId query) {
  const double travelled = travelled_to(map, query);
  const double since = travelled - last_attempt_;
  if (since < options_.min_travel || since <= 0) return false;  // asked again at the same place: nothing new to see
  const Timestamp now = keyframe(map, query).time;
  if (last_time_ && to_seconds(now - *last_time_) < options_.min_period) return false;
  pending_ = {.query = query, .travelled = travelled, .candidates = {}};
  const std::vector<KeyframeId> found = candidates(map, query);
  for (std::size_t k = found.size(); k > 0; --k) pending_.candidates.push_back(found[k - 1]);
  if (found.empty()) return true;
  last_attempt_ = travelled;
  last_time_ = now;
  return true;
}

template <class Candidates, class Registration>
std::vector<KeyframeId> MapMerger<Candidates, Registration>::candidates(const SlamMap& map, KeyframeId query) {
  std::vector<KeyframeId> found = candidates_.find(map, query);
  if constexpr (requires { candidates_.misplaced(map, query); }) {
    LoopClosure as_it_is;
    as_it_is.to = query;
    for (const KeyframeId id : candidates_.misplaced(map, query)) {
      as_it_is.from = id;
      as_it_is.T_from_to = keyframe(map, id).T_map_body.inverse() * keyframe(map, query).T_map_body;
      if (hypotheses_.ask_fixes(map, as_it_is) == detail::FixVerdict::contradict) found.push_back(id);
    }
  }
  return found;
}

template <class Candidates, class Registration>
std::vector<LoopClosure> MapMerger<Candidates, Registration>::withdraw() {
  path_ = {};
  pending_ = {};
  last_attempt_ = last_asked_ = -std::numeric_limits<double>::infinity();
  last_time_.reset();
  return hypotheses_.withdraw();
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
  if constexpr (requires { candidates_.guess(from, to); })
    if (const std::optional<SE3d> guess = candidates_.guess(from, to))
      return align_from(map, from, to, *guess, closer, executor);
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
  return is_same_frame(map, closure) ? ClosureVerdict::implausible : ClosureVerdict::accepted;
}

template <class Candidates, class Registration>
template <class Closer, Executor E>
LoopClosure MapMerger<Candidates, Registration>::align_from(const SlamMap& map, KeyframeId from, KeyframeId to,
                                                            const SE3d& guess, Closer& closer,
                                                            const E& executor) const {
  LoopClosure closure = closer.align(map.keyframes, from, to, guess, executor);
  closure.kind = ClosureKind::merge;
  if (closure.verdict == ClosureVerdict::accepted && is_same_frame(map, closure))
    closure.verdict = ClosureVerdict::implausible;
  return closure;
}

template <class Candidates, class Registration>
template <class Closer, Executor E>
void MapMerger<Candidates, Registration>::confirm_alone(const SlamMap& map, std::vector<LoopClosure>& tried,
                                                        Closer& closer, const E& executor) {
  for (detail::MergeHypothesis& one : hypotheses_.all()) {
    if (options_.supporting_scans <= 0 || one.needs_others) continue;
    if (hypotheses_.ask_fixes(map, one.closure) != detail::FixVerdict::agree) continue;
    if (is_witnessed(map, one.closure, closer, executor)) {
      hypotheses_.accept(map, one, tried);
      return;
    }
    one.needs_others = path_.length - one.travelled >= options_.min_place_distance;  // else there are scans to come
  }
}

template <class Candidates, class Registration>
template <class Closer, Executor E>
bool MapMerger<Candidates, Registration>::is_witnessed(const SlamMap& map, const LoopClosure& closure, Closer& closer,
                                                       const E& executor) const {
  constexpr double share = 0.25;  // of what two places may differ by
  const Session& session = map.sessions[static_cast<std::size_t>(keyframe(map, closure.to).session.value)];
  Index agreeing = 0;
  for (Index step = 1; step <= options_.supporting_scans; ++step)
    for (const Index near : {closure.to.value - step, closure.to.value + step}) {
      if (near < session.first_keyframe || near >= session.end_keyframe()) continue;
      const SE3d T_to_near =
          keyframe(map, closure.to).T_map_body.inverse() * keyframe(map, KeyframeId{near}).T_map_body;
      const SE3d guess = closure.T_from_to * T_to_near;
      const LoopClosure seen = closer.align(map.keyframes, closure.from, KeyframeId{near}, guess, executor);
      const SE3d off = guess.inverse() * seen.T_from_to;
      if (seen.verdict == ClosureVerdict::accepted && off.translation().norm() <= share * options_.agree_translation &&
          off.rotation().log().norm() <= share * options_.agree_rotation)
        ++agreeing;
    }
  return agreeing >= options_.supporting_scans;
}

/// Joins no frames: every session stays by itself.
struct NoMerging {
  /// Nothing.
  template <class Closer, Executor E = Serial>
  [[nodiscard]] std::vector<LoopClosure> attempt(const SlamMap& /*map*/, KeyframeId /*query*/, Closer& /*closer*/,
                                                 const E& /*executor*/ = {}) const {
    return {};
  }
  [[nodiscard]] std::vector<LoopClosure> withdraw() const { return {}; }  ///< nothing
};

}  // namespace chainslam
