#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>
#include <string>
#include <vector>

#include "chainslam/slam/gnss_candidates.hpp"
#include "slam/scripted.hpp"
#include "slam/street.hpp"

namespace chainslam::test {

inline constexpr Index per_session = 50;  ///< keyframes of a session: 100 m of the 160 m round the block

/// Drives round the same block, side by side, each starting somewhere else and in a frame of its own, with odometry
/// that drifts by half a metre. What registration measures is exact.
struct DrivesRoundTheBlock {
  std::vector<SE3d> truth;  ///< T_world_body of all keyframes
  std::vector<SE3d> odometry;
  std::vector<SE3d> T_world_odom;
  std::shared_ptr<Script> script = std::make_shared<Script>();
  KeyframeId blind{};  ///< whose scan fits nowhere

  explicit DrivesRoundTheBlock(int sessions) {
    const std::vector<SE3d> round = way_round(2.0, -2.0);
    Rng rng(7);
    Vector6d drift;
    drift << 0.005, 0.002, 0.001, 0.0001, 0, 0.0002;
    for (int session = 0; session < sessions; ++session) {
      std::vector<SE3d> way;
      for (Index i = 0; i < per_session; ++i)
        way.push_back(round[static_cast<std::size_t>(12 * session + i) % round.size()] *
                      SE3d(SO3d(), {0, 0.7 * session, 0}));
      T_world_odom.push_back(way.front() * random_motion(rng, 3, 0.2));
      for (const SE3d& pose : drifting(way, drift)) odometry.push_back(T_world_odom.back().inverse() * pose);
      truth.insert(truth.end(), way.begin(), way.end());
    }
  }

  [[nodiscard]] TruthCloser closer() const {
    TruthCloser closer;
    closer.truth = std::make_shared<const std::vector<SE3d>>(truth);
    closer.blind = blind;
    return closer;
  }

  /// Begins a session and adds its keyframes; fixes come with them, if the receiver works.
  template <class Target>
  void drive(Target& back_end, Index session, bool gnss = true) const {
    back_end.begin_session(std::string(1, static_cast<char>('a' + session)));
    for (Index i = 0; i < per_session; ++i) {
      const auto at = static_cast<std::size_t>(session * per_session + i);
      back_end.add(keyframe_at(i, odometry[at]));
      if (gnss) back_end.add(fix_at(Timestamp::from_seconds(i), truth[at].translation()));
    }
  }

  [[nodiscard]] SE3d between(Index from, Index to) const {
    return truth[static_cast<std::size_t>(from)].inverse() * truth[static_cast<std::size_t>(to)];
  }
  void place(Index query, Index candidate, const SE3d& error = {}) {
    script->places.push_back({query, candidate, between(candidate, query) * error});
  }
};

/// Place recognition by GNSS; registration then finds the true pose, but for half a metre.
struct GnssPlaces {
  const DrivesRoundTheBlock* drives;
  GnssCandidates candidates{};

  [[nodiscard]] std::vector<KeyframeId> find(const SlamMap& map, KeyframeId query) {
    const std::vector<KeyframeId> found = candidates.find(map, query);
    Script& script = *drives->script;
    script = {};
    for (const KeyframeId id : found) {
      script.proposed.push_back(script.places.size());
      script.places.push_back(
          {query.value, id.value, drives->between(id.value, query.value) * SE3d(SO3d(), {0.5, 0, 0})});
    }
    return found;
  }
};

/// Between keyframes of two sessions that are within 10 m of each other: how far off the map has their relative pose.
inline double inter_session_error(const DrivesRoundTheBlock& drives, const SlamMap& map, Index a, Index b) {
  double most = 0;
  for (Index i = a * per_session; i < (a + 1) * per_session; ++i)
    for (Index j = b * per_session; j < (b + 1) * per_session; ++j) {
      const SE3d truth = drives.between(i, j);
      if (truth.translation().norm() > 10) continue;
      const SE3d ours = map.keyframes[static_cast<std::size_t>(i)].T_map_body.inverse() *
                        map.keyframes[static_cast<std::size_t>(j)].T_map_body;
      most = std::max(most, translation_error(truth, ours));
    }
  return most;
}

}  // namespace chainslam::test
