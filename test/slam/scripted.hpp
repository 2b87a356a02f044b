#pragma once

#include <doctest/doctest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cstddef>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/registration/concepts.hpp"
#include "chainslam/sensor/packet.hpp"
#include "chainslam/slam/closure_candidates.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::test {

/// Local east, north and up in metres, somewhere on the Earth.
[[nodiscard]] inline Eigen::Vector3d ecef(const Eigen::Vector3d& p_local) {
  const Eigen::Vector3d base(4'200'000, 600'000, 4'750'000);
  const Eigen::Vector3d up = base.normalized();
  const Eigen::Vector3d east = Eigen::Vector3d::UnitZ().cross(up).normalized();
  return base + p_local.x() * east + p_local.y() * up.cross(east) + p_local.z() * up;
}

[[nodiscard]] inline GnssFix fix_at(Timestamp time, const Eigen::Vector3d& p_local, double sigma = 1.0) {
  return {time, ecef(p_local), sigma * sigma * Eigen::Matrix3d::Identity(), GnssQuality::three_dimensional};
}

/// One alignment that somebody asked for.
struct Asked {
  KeyframeId from, to;
  SE3d guess;
};

/// Knows where every keyframe truly was, and measures what is asked without scans: exactly, if the two were near enough
/// to see the same.
struct TruthCloser {
  std::shared_ptr<const std::vector<SE3d>> truth;  ///< by keyframe
  double reach = 12.0;                             ///< metres
  double sigma = 0.02;                             ///< metres and radians, as stated
  KeyframeId blind{};                              ///< whose scan fits nowhere
  ProximityCandidates candidates{};
  std::shared_ptr<std::vector<Asked>> asked = std::make_shared<std::vector<Asked>>();

  [[nodiscard]] bool eligible(const Keyframe& candidate, const Keyframe& query) const {
    return candidates.eligible(candidate, query);
  }

  template <Executor E = Serial>
  [[nodiscard]] LoopClosure align(std::span<const Keyframe>, KeyframeId from, KeyframeId to, const SE3d& guess,
                                  const E& = {}) {
    asked->push_back({from, to, guess});
    const SE3d between = at(from).inverse() * at(to);
    LoopClosure closure{.from = from, .to = to, .T_from_to = between};
    closure.verdict = between.translation().norm() <= reach && to != blind ? ClosureVerdict::accepted
                                                                           : ClosureVerdict::too_few_inliers;
    if (closure.verdict == ClosureVerdict::accepted) closure.sqrt_information = SqrtInformation<6>::Identity() / sigma;
    return closure;
  }

  template <Executor E = Serial>
  [[nodiscard]] std::vector<LoopClosure> search(std::span<const Keyframe> keyframes, const PositionIndex& index,
                                                KeyframeId query, const E& executor = {}) {
    std::vector<LoopClosure> tried;
    const SE3d& here = keyframes[static_cast<std::size_t>(query.value)].T_map_body;
    for (const KeyframeId candidate : candidates.find(keyframes, index, query)) {
      const SE3d guess = keyframes[static_cast<std::size_t>(candidate.value)].T_map_body.inverse() * here;
      tried.push_back(align(keyframes, candidate, query, guess, executor));
      if (tried.back().verdict == ClosureVerdict::accepted) break;
    }
    return tried;
  }

  template <Executor E = Serial>
  [[nodiscard]] std::vector<LoopClosure> close(std::span<const Keyframe> keyframes, const PositionIndex& index,
                                               const E& executor = {}) {
    return search(keyframes, index, keyframes.back().id, executor);
  }

 private:
  [[nodiscard]] const SE3d& at(KeyframeId id) const { return (*truth)[static_cast<std::size_t>(id.value)]; }
};

/// What place recognition proposes for a keyframe, and what registration then says.
struct Place {
  Index query, candidate;
  SE3d T_candidate_query;
  double fitness = 0.4;
  double putative_ratio = 0.3;
  double source_fitness = 0.8;
  double inlier_rmse = 0.3;
  GlobalAlignStatus status = GlobalAlignStatus::found;
  bool verified = false;
};

/// The places of a script in its order, and how many of the proposed ones were registered.
struct Script {
  std::vector<Place> places;
  std::vector<std::size_t> proposed{};
  std::size_t registered = 0;
};

/// Proposes what the script has for the query.
struct ScriptedPlaces {
  std::shared_ptr<Script> script;

  [[nodiscard]] std::vector<KeyframeId> find(const SlamMap& map, KeyframeId query) {
    std::vector<KeyframeId> found;
    script->proposed.clear();
    script->registered = 0;
    const auto frame = [&](Index id) {
      const SessionId session = map.keyframes[static_cast<std::size_t>(id)].session;
      return map.sessions[static_cast<std::size_t>(session.value)].frame;
    };
    for (std::size_t i = 0; i < script->places.size(); ++i) {
      const Place& place = script->places[i];
      if (place.query != query.value || frame(place.candidate) == frame(place.query)) continue;
      script->proposed.push_back(i);
      found.push_back(KeyframeId{place.candidate});
    }
    return found;
  }
};

/// Finds what the script says of the places just proposed, one after the other.
struct ScriptedRegistration {
  std::shared_ptr<Script> script;

  template <Cloud Source, Cloud Target, Executor E = Serial>
  [[nodiscard]] GlobalAlignResult align(const Source&, const Target&, const E& = {}) const {
    const Place& place = script->places[script->proposed[script->registered++]];
    GlobalAlignResult result;
    result.T_target_source = place.T_candidate_query;
    result.fitness_target = place.fitness;
    result.putative_ratio = place.putative_ratio;
    result.fitness_source = place.source_fitness;
    result.inlier_rmse = place.inlier_rmse;
    result.status = place.status;
    result.verified = place.verified;
    return result;
  }
};

/// The largest difference between two maps' poses of one keyframe: the norm of its tangent, metres and radians.
[[nodiscard]] inline double farthest_apart(const SlamMap& a, const SlamMap& b) {
  REQUIRE(a.keyframes.size() == b.keyframes.size());
  double most = 0;
  for (std::size_t i = 0; i < a.keyframes.size(); ++i)
    most = std::max(most, a.keyframes[i].T_map_body.local(b.keyframes[i].T_map_body).norm());
  return most;
}

}  // namespace chainslam::test
