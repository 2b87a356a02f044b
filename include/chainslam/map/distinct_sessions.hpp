#pragma once

#include <algorithm>
#include <cstddef>
#include <span>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/map/slam_map.hpp"

namespace chainslam {

/// A session of one of several maps.
struct SessionPlace {
  std::size_t map = 0;                                                         ///< position among the maps
  SessionId session{};                                                         ///< in that map
  friend bool operator==(const SessionPlace&, const SessionPlace&) = default;  ///< whether all members are equal
};

/// A recording that several maps have.
struct RepeatedSession {
  SessionPlace left_out{};  ///< this one
  SessionPlace taken{};     ///< since this one has as much of it, or more
};

/// The recordings of several maps, each once.
struct DistinctSessions {
  std::vector<SessionPlace> taken;        ///< map by map, in their order
  std::vector<RepeatedSession> left_out;  ///< the same
};

/// Whether two sessions are of one recording: half of the shorter one's keyframes are keyframes of the other, with the
/// same time, pose of odometry and number of points. That holds for maps that were saved from one another, also if one
/// has the recording only in part; not for a recording that was mapped twice with different settings.
[[nodiscard]] inline bool is_same_recording(const SlamMap& map_a, const Session& a, const SlamMap& map_b,
                                            const Session& b) {
  Index same = 0;
  Index i = a.first_keyframe, k = b.first_keyframe;
  while (i < a.end_keyframe() && k < b.end_keyframe()) {
    const Keyframe& one = map_a.keyframes[static_cast<std::size_t>(i)];
    const Keyframe& other = map_b.keyframes[static_cast<std::size_t>(k)];
    if (one.time == other.time && one.T_odom_body == other.T_odom_body && one.cloud.size() == other.cloud.size())
      ++same;
    i += one.time <= other.time ? 1 : 0;
    k += other.time <= one.time ? 1 : 0;
  }
  return same > 0 && 2 * same >= std::min(a.keyframes, b.keyframes);
}

/// Each recording once, from the map with the most keyframes of it; of equals, from the first. Sessions of one map are
/// all different: it is taken as it was made.
[[nodiscard]] inline DistinctSessions distinct_sessions(std::span<const SlamMap* const> maps) {
  const auto session_at = [&](const SessionPlace& place) -> const Session& {
    return maps[place.map]->sessions[static_cast<std::size_t>(place.session.value)];
  };
  const auto in_order = [](const SessionPlace& a, const SessionPlace& b) {
    return a.map != b.map ? a.map < b.map : a.session < b.session;
  };
  std::vector<SessionPlace> places;
  for (std::size_t map = 0; map < maps.size(); ++map)
    for (const Session& session : maps[map]->sessions) places.push_back({map, session.id});
  std::stable_sort(places.begin(), places.end(), [&](const SessionPlace& a, const SessionPlace& b) {
    return session_at(a).keyframes > session_at(b).keyframes;
  });
  DistinctSessions distinct;
  for (const SessionPlace& place : places) {
    const auto same = std::find_if(distinct.taken.begin(), distinct.taken.end(), [&](const SessionPlace& one) {
      return one.map != place.map &&
             is_same_recording(*maps[one.map], session_at(one), *maps[place.map], session_at(place));
    });
    if (same == distinct.taken.end())
      distinct.taken.push_back(place);
    else
      distinct.left_out.push_back({place, *same});
  }
  std::sort(distinct.taken.begin(), distinct.taken.end(), in_order);
  std::sort(distinct.left_out.begin(), distinct.left_out.end(),
            [&](const RepeatedSession& a, const RepeatedSession& b) { return in_order(a.left_out, b.left_out); });
  return distinct;
}

}  // namespace chainslam
