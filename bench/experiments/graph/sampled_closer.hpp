#pragma once

#include <Eigen/Core>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/core/executor.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/slam/back_end.hpp"
#include "graph/attempts.hpp"

namespace chainslam::experiments {

/// What stands for scans: true poses, and what alignments came to in a run with scans.
struct SampledScans {
  static constexpr double cell = 10.0;  ///< metres, of a grid in the plane

  std::vector<SE3d> truth;                                           ///< T_truth_body by keyframe
  std::map<std::pair<Index, Index>, std::vector<KeyframeId>> cells;  ///< where these are, in their order
  Attempts attempts;
  Rng rng;  ///< of closures

  /// Equal pairs of keyframes get equal alignments, whatever else is tried, so that two back ends can be compared.
  [[nodiscard]] Rng of_pair(KeyframeId from, KeyframeId to) const {
    return rng.fork(static_cast<std::uint64_t>(from.value)).fork(static_cast<std::uint64_t>(to.value));
  }
  void add(const SE3d& T_truth_body) {
    cells[cell_of(T_truth_body.translation())].push_back(KeyframeId{to_index(truth.size())});
    truth.push_back(T_truth_body);
  }
  [[nodiscard]] static std::pair<Index, Index> cell_of(const Eigen::Vector3d& position) {
    return {static_cast<Index>(std::floor(position.x() / cell)), static_cast<Index>(std::floor(position.y() / cell))};
  }
  /// Calls visit(id) for keyframes up to `end`, all of those within a radius of a position among them.
  template <class Visit>
  void for_each_near(const Eigen::Vector3d& position, double radius, Index end, Visit&& visit) const {
    const auto [x, y] = cell_of(position);
    const auto reach = static_cast<Index>(std::ceil(radius / cell));
    for (Index i = x - reach; i <= x + reach; ++i)
      for (Index j = y - reach; j <= y + reach; ++j)
        if (const auto found = cells.find({i, j}); found != cells.end())
          for (const KeyframeId id : found->second)
            if (id.value < end) visit(id);
  }
  [[nodiscard]] SE3d T_true(KeyframeId from, KeyframeId to) const {
    return truth[static_cast<std::size_t>(from.value)].inverse() * truth[static_cast<std::size_t>(to.value)];
  }
};

/// `LoopCloser` without scans: an alignment comes to what one over a like distance has come to.
class SampledCloser {
 public:
  SampledCloser(std::shared_ptr<const SampledScans> scans, const LoopCloserOptions& options,
                const ProximityCandidates& candidates)
      : scans_(std::move(scans)), options_(options), candidates_(candidates) {}

  template <Executor E = Serial>
  [[nodiscard]] std::vector<LoopClosure> close(std::span<const Keyframe> keyframes, const PositionIndex& index,
                                               const E& executor = {}) {
    if (keyframes.empty() || !due(keyframes)) return {};
    return search(keyframes, index, keyframes.back().id, executor);
  }

  template <Executor E = Serial>
  [[nodiscard]] std::vector<LoopClosure> search(std::span<const Keyframe> keyframes, const PositionIndex& index,
                                                KeyframeId query, const E& executor = {}) {
    std::vector<LoopClosure> tried;
    const SE3d& here = keyframes[static_cast<std::size_t>(query.value)].T_map_body;
    for (const KeyframeId candidate : candidates_.find(keyframes, index, query)) {
      const SE3d guess = keyframes[static_cast<std::size_t>(candidate.value)].T_map_body.inverse() * here;
      tried.push_back(align(keyframes, candidate, query, guess, executor));
      if (tried.back().verdict == ClosureVerdict::accepted) break;
    }
    return tried;
  }

  [[nodiscard]] bool eligible(const Keyframe& candidate, const Keyframe& query) const {
    return candidates_.eligible(candidate, query);
  }

  template <Executor E = Serial>
  [[nodiscard]] LoopClosure align(std::span<const Keyframe> /*keyframes*/, KeyframeId from, KeyframeId to,
                                  const SE3d& guess, const E& /*executor*/ = {}) {
    LoopClosure closure{.from = from, .to = to, .T_from_to = guess, .verdict = ClosureVerdict::not_converged};
    const std::vector<Attempt>& attempts = scans_->attempts.closures;
    if (attempts.empty()) return closure;
    const SE3d T_true = scans_->T_true(from, to);
    Rng rng = scans_->of_pair(from, to);
    const Attempt& attempt = drawn(attempts, T_true.translation().norm(), rng);
    if (!attempt.converged) return closure;
    closure.T_from_to = T_true * SE3d::exp(attempt.error);
    closure.mean_squared_error = attempt.mean_squared_error;
    const SE3d correction = guess.inverse() * closure.T_from_to;
    const bool plausible = correction.translation().norm() <= options_.gate.max_translation &&
                           correction.rotation().log().norm() <= options_.gate.max_rotation;
    closure.verdict = plausible ? ClosureVerdict::accepted : ClosureVerdict::implausible;
    if (plausible) closure.sqrt_information = information_of(attempt, attempts, rng);
    return closure;
  }

 private:
  /// As `LoopCloser` has it.
  [[nodiscard]] bool due(std::span<const Keyframe> keyframes) {
    const Keyframe& newest = keyframes.back();
    if (keyframes.size() > 1 && keyframes[keyframes.size() - 2].session == newest.session)
      travelled_ += (keyframes[keyframes.size() - 2].T_odom_body.inverse() * newest.T_odom_body).translation().norm();
    const bool same_session = searched_ && searched_->first == newest.session;
    if (travelled_ < options_.min_travel) return false;
    if (same_session && to_seconds(newest.time - searched_->second) < options_.min_period) return false;
    searched_ = {newest.session, newest.time};
    travelled_ = 0;
    return true;
  }

  std::shared_ptr<const SampledScans> scans_;
  LoopCloserOptions options_;
  ProximityCandidates candidates_;
  double travelled_ = std::numeric_limits<double>::infinity();
  std::optional<std::pair<SessionId, Timestamp>> searched_;
};

/// `MapMerger` without scans and fixes: places that are near in truth are tried, and come to what a run's have come to.
class SampledMerger {
 public:
  SampledMerger(std::shared_ptr<const SampledScans> scans, const MergeOptions& options, double radius)
      : scans_(std::move(scans)), options_(options), radius_(radius) {}

  template <class Closer, Executor E = Serial>
  [[nodiscard]] std::vector<LoopClosure> attempt(const SlamMap& map, KeyframeId query, Closer& /*closer*/,
                                                 const E& /*executor*/ = {}) {
    const Session& session = map.sessions.back();
    if (session_ != session.id) start(session.id);
    if (path_end_ && query.value <= *path_end_) return {};  // brought again by its fix, which says nothing here
    const std::vector<Attempt>& attempts = scans_->attempts.merges;
    const std::optional<KeyframeId> near = nearest(map, session, query);
    const double travelled = path_to(map, session, query);
    if (!options_.enabled || attempts.empty() || !near || travelled - last_ < options_.min_travel) return {};
    last_ = travelled;
    Rng rng = scans_->of_pair(*near, query);
    const Attempt& drawn = attempts[static_cast<std::size_t>(rng.uniform_index(static_cast<Index>(attempts.size())))];
    if (!drawn.converged || (!agreeing_.empty() && travelled - confirmed_ < options_.min_place_distance)) return {};
    confirmed_ = travelled;
    LoopClosure closure{.from = *near, .to = query, .T_from_to = scans_->T_true(*near, query) * SE3d::exp(drawn.error)};
    closure.kind = ClosureKind::merge;
    closure.mean_squared_error = drawn.mean_squared_error;
    closure.sqrt_information = information_of(drawn, attempts, rng);
    agreeing_.push_back(closure);
    if (to_index(agreeing_.size()) < options_.confirmations) return {};
    return std::exchange(agreeing_, {});
  }

  [[nodiscard]] std::vector<LoopClosure> withdraw() { return {}; }

 private:
  void start(SessionId session) {
    session_ = session;
    agreeing_.clear();
    last_ = confirmed_ = -std::numeric_limits<double>::infinity();
    path_ = 0;
    path_end_.reset();
  }

  [[nodiscard]] const SE3d& at(KeyframeId id) const { return scans_->truth[static_cast<std::size_t>(id.value)]; }

  [[nodiscard]] std::optional<KeyframeId> nearest(const SlamMap& map, const Session& session, KeyframeId query) const {
    std::optional<KeyframeId> found;
    double least = radius_;
    scans_->for_each_near(at(query).translation(), radius_, session.first_keyframe, [&](KeyframeId id) {
      const Keyframe& other = map.keyframes[static_cast<std::size_t>(id.value)];
      if (map.sessions[static_cast<std::size_t>(other.session.value)].frame == session.frame) return;
      const double distance = (at(id).translation() - at(query).translation()).norm();
      if (distance < least || (found && distance == least && id < *found)) found = id, least = distance;
    });
    return found;
  }

  /// Metres from the session's start; queries come in order.
  [[nodiscard]] double path_to(const SlamMap& map, const Session& session, KeyframeId query) {
    for (Index i = path_end_ ? *path_end_ : session.first_keyframe; i < query.value; ++i)
      path_ += (map.keyframes[static_cast<std::size_t>(i)].T_odom_body.inverse() *
                map.keyframes[static_cast<std::size_t>(i + 1)].T_odom_body)
                   .translation()
                   .norm();
    path_end_ = query.value;
    return path_;
  }

  std::shared_ptr<const SampledScans> scans_;
  MergeOptions options_;
  double radius_;  ///< metres
  SessionId session_{-1};
  std::vector<LoopClosure> agreeing_;
  double last_ = 0, confirmed_ = 0, path_ = 0;
  std::optional<Index> path_end_;
};

}  // namespace chainslam::experiments
