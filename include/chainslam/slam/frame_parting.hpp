#pragma once

#include <algorithm>
#include <span>
#include <vector>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam {

// How a merge is taken back: frames are parted where nothing that counts connects them any more, and closures that are
// withdrawn take everything with them that was derived from them. All of it is read off the map's own records, so that
// a map that was saved and loaded parts as the one that was saved would.
namespace detail {

[[nodiscard]] inline SessionId session_of(const SlamMap& map, KeyframeId id) {
  return map.keyframes[static_cast<std::size_t>(id.value)].session;
}

[[nodiscard]] inline SessionId frame_of(const SlamMap& map, KeyframeId id) {
  return map.sessions[static_cast<std::size_t>(session_of(map, id).value)].frame;
}

/// The number of the group that a session is in, where each names the next towards it.
[[nodiscard]] inline Index root_of(const Table<Index>& groups, Index session) {
  while (groups[session] != session) session = groups[session];
  return session;
}

/// Joins two groups under the earlier of their first sessions.
inline void unite(Table<Index>& groups, Index a, Index b) {
  a = root_of(groups, a);
  b = root_of(groups, b);
  groups[std::max(a, b)] = std::min(a, b);
}

}  // namespace detail

/// Of each session, the one whose start is to define its frame, if only accepted closures hold sessions together.
///
/// What no closure ever connected with the rest of its frame stays there: it was put there by other means.
[[nodiscard]] [[gnu::cold]] inline detail::Table<SessionId> frames_held(const SlamMap& map) {
  const auto grouped = [&](bool held) {
    detail::Table<Index> groups;
    for (const Session& session : map.sessions) groups.push_back(session.id.value);
    for (const LoopClosure& closure : map.closures) {
      const SessionId from = detail::session_of(map, closure.from), to = detail::session_of(map, closure.to);
      const bool one_frame = detail::frame_of(map, closure.from) == detail::frame_of(map, closure.to);
      if (one_frame && (!held || closure.verdict == ClosureVerdict::accepted))
        detail::unite(groups, from.value, to.value);
    }
    return groups;
  };
  const detail::Table<Index> known = grouped(false), held = grouped(true);
  detail::Table<SessionId> frames;
  for (const Session& session : map.sessions) {
    const Index here = session.id.value, there = session.frame.value;
    const bool stays = !session.frame.valid() || detail::root_of(known, here) != detail::root_of(known, there) ||
                       detail::root_of(held, here) == detail::root_of(held, there);
    frames.push_back(stays ? session.frame : SessionId{detail::root_of(held, here)});
  }
  return frames;
}

/// Whether accepted closures hold each frame together, so far as closures ever did.
[[nodiscard]] [[gnu::cold]] inline bool is_held(const SlamMap& map) {
  const detail::Table<SessionId> frames = frames_held(map);
  return std::all_of(map.sessions.begin(), map.sessions.end(),
                     [&](const Session& session) { return frames[session.id.value] == session.frame; });
}

/// Withdraws closures, by their positions, and all that they led to.
[[gnu::cold]] inline void withdraw_closures(SlamMap& map, std::span<const Index> positions) {
  for (const Index position : positions)
    map.closures[static_cast<std::size_t>(position)].verdict = ClosureVerdict::reverted;
  for (LoopClosure& closure : map.closures)  // what a closure led to comes after it
    if (closure.cause >= 0 && map.closures[static_cast<std::size_t>(closure.cause)].verdict == ClosureVerdict::reverted)
      closure.verdict = ClosureVerdict::reverted;
}

/// Parts frames that nothing holds together: those who leave one go back, as one body, to where odometry put the first
/// of them. Closures between frames become `reverted`.
/// @param anchor  square root of the information of the prior that holds a new frame's first keyframe
[[gnu::cold]] inline void part_frames(SlamMap& map, const SqrtInformation<6>& anchor) {
  const detail::Table<SessionId> frames = frames_held(map);
  for (Session& session : map.sessions) {
    if (session.frame == session.id || frames[session.id.value] != session.id) continue;
    const Keyframe start = map.keyframes[static_cast<std::size_t>(session.first_keyframe)];
    const SE3d T_new_old = start.T_odom_body * start.T_map_body.inverse();
    for (Keyframe& keyframe : map.keyframes)
      if (frames[keyframe.session.value] == session.id) keyframe.T_map_body = T_new_old * keyframe.T_map_body;
    for (Session& other : map.sessions)
      if (frames[other.id.value] == session.id) other.prior = T_new_old * other.prior;
    session.prior = start.T_odom_body;
    session.prior_sqrt_information = anchor;
  }
  for (Session& session : map.sessions) session.frame = frames[session.id.value];
  for (LoopClosure& closure : map.closures)
    if (detail::frame_of(map, closure.from) != detail::frame_of(map, closure.to))
      closure.verdict = ClosureVerdict::reverted;
}

}  // namespace chainslam
