#pragma once

#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/map/slam_map.hpp"

namespace chainslam {

/// Adds another map's records behind those that are there: its sessions, keyframes and closures are counted on, all
/// else stays as it was.
inline void append_map(SlamMap& map, const SlamMap& other) {
  const Index keyframes = to_index(map.keyframes.size());
  const Index sessions = to_index(map.sessions.size());
  const Index closures = to_index(map.closures.size());
  const auto moved = [&](KeyframeId id) { return KeyframeId{id.value + keyframes}; };
  for (Session session : other.sessions) {
    session.id.value += sessions;
    session.frame.value += sessions;
    session.first_keyframe += keyframes;
    map.sessions.push_back(std::move(session));
  }
  for (Keyframe keyframe : other.keyframes) {
    keyframe.id = moved(keyframe.id);
    keyframe.session.value += sessions;
    if (KeyframeId& after = keyframe.gnss_arrival.after; after.valid()) after = moved(after);
    map.keyframes.push_back(std::move(keyframe));
  }
  for (OdometryMeasurement step : other.odometry) {
    step.from = moved(step.from);
    step.to = moved(step.to);
    map.odometry.push_back(step);
  }
  for (FrameRecord frame : other.frames) {
    frame.session.value += sessions;
    map.frames.push_back(frame);
  }
  const auto append_closures = [&](const std::vector<LoopClosure>& from, std::vector<LoopClosure>& to) {
    for (LoopClosure closure : from) {
      closure.from = moved(closure.from);
      closure.to = moved(closure.to);
      if (closure.cause >= 0) closure.cause += closures;
      to.push_back(closure);
    }
  };
  append_closures(other.closures, map.closures);
  append_closures(other.refusals, map.refusals);
}

}  // namespace chainslam
