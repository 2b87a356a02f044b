#pragma once

#include <algorithm>
#include <cstddef>
#include <optional>
#include <span>
#include <stdexcept>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/sensor/frame.hpp"
#include "chainslam/sensor/packet.hpp"
#include "chainslam/slam/frame_records.hpp"
#include "chainslam/slam/keyframe_scan.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam {

/// When a keyframe got its fix, so that a back end can be given the same again.
struct GnssArrival {
  KeyframeId after{};          ///< the newest keyframe then; none: it came with its own, or nothing is known
  bool with_previous = false;  ///< together with that of the keyframe before
  friend bool operator==(const GnssArrival&, const GnssArrival&) = default;  ///< whether all members are equal
};

/// A frame that the map keeps. Scans are shared and never change; only `T_map_body` moves when the graph is optimized.
struct Keyframe {
  KeyframeId id{};                ///< position among the map's keyframes
  SessionId session{};            ///< the session that it belongs to
  Timestamp time{};               ///< of the pose
  SE3d T_odom_body{};             ///< as odometry gave it, in its session's own frame
  SE3d T_map_body{};              ///< the graph's latest estimate
  KeyframeScan cloud{};           ///< body frame, motion-corrected, voxelised
  std::optional<GnssFix> gnss{};  ///< interpolated to `time`
  GnssArrival gnss_arrival{};     ///< of `gnss`
};

/// A keyframe's fix, which came after it.
struct KeyframeFix {
  KeyframeId keyframe{};  ///< where it was taken
  GnssFix fix{};          ///< interpolated to the keyframe's time
};

/// One drive: a range of consecutive keyframes.
struct Session {
  SessionId id{};            ///< position among the map's sessions
  std::string name{};        ///< as the user gave it
  Index first_keyframe = 0;  ///< position of its first keyframe
  Index keyframes = 0;       ///< how many keyframes
  /// The session whose start defines the frame that this one's T_map_body are in: itself, until a merge joins it to
  /// an earlier one.
  SessionId frame{};
  /// What the graph knows of the first keyframe beforehand: where T_map_body is, and how well. Zero: nothing.
  SE3d prior{};
  /// Of `prior`, tangent [translation; rotation].
  SqrtInformation<6> prior_sqrt_information = zeros<SqrtInformation<6>>();

  [[nodiscard]] Index end_keyframe() const { return first_keyframe + keyframes; }  ///< behind its last keyframe
};

/// Where a measurement between two keyframes came from.
enum class ClosureKind {
  direct,   ///< the search around the newest keyframe
  chained,  ///< a keyframe connected to the partner of a direct closure
  merge     ///< place recognition between two frames, which it joined
};

/// Why a candidate was refused; `accepted` if it was not.
enum class ClosureVerdict {
  accepted,
  not_converged,
  too_few_inliers,
  high_residual,
  implausible,   ///< farther from the estimate than that may be off
  low_fitness,   ///< too little of the target found again
  inconsistent,  ///< contradicts what is already connected
  unconfirmed,   ///< a merge that neither a second place nor enough of one agreed with
  reverted,      ///< of a merge that was taken back, or derived from it
  against_fixes  ///< a merge that the GNSS fixes of both sessions contradict
};

/// A measured relative pose between two keyframes that are not neighbours in time, or the record of one that was
/// refused.
struct LoopClosure {
  KeyframeId from{};  ///< j, the older keyframe, whose submap was the target
  KeyframeId to{};    ///< i, the keyframe whose scan was aligned
  SE3d T_from_to{};   ///< T_j_i = x_j^-1 x_i
  /// Of T_from_to, tangent [translation; rotation]. Zero: known to no degree, and no factor in the graph.
  SqrtInformation<6> sqrt_information = zeros<SqrtInformation<6>>();
  ClosureKind kind = ClosureKind::direct;             ///< what the measurement came from
  ClosureVerdict verdict = ClosureVerdict::accepted;  ///< whether it was accepted, and if not, why
  double mean_squared_error = 0;                      ///< m^2 over inlier correspondences (e_ij of the paper)
  /// Inliers over source points; of a merge, over target points (f^R_ij of the paper).
  double inlier_ratio = 0;
  /// Position among the map's closures of the one that led to this: a chained one's direct closure, or the merge whose
  /// recheck found a direct one. -1: none.
  Index cause = -1;

  /// Whether it is in the pose graph, if only with the weight of an outlier.
  [[nodiscard]] bool is_factor() const { return verdict != ClosureVerdict::reverted && !sqrt_information.isZero(0); }
};

/// Relative pose of two consecutive keyframes of a session, as odometry measured it.
struct OdometryMeasurement {
  KeyframeId from{};                                                  ///< the earlier keyframe
  KeyframeId to{};                                                    ///< the later keyframe
  SE3d T_from_to{};                                                   ///< as odometry measured it
  SqrtInformation<6> sqrt_information = zeros<SqrtInformation<6>>();  ///< tangent [translation; rotation]
};

/// All that mapping found out: sessions, keyframes (ids are positions in `keyframes`) and what connects them.
///
/// Measurements are kept as they were made, so that a map that is loaded has the optimum that it had when it was saved.
struct SlamMap {
  std::vector<Session> sessions;              ///< in the order in which they were driven
  std::vector<Keyframe> keyframes;            ///< all sessions' one after the other
  std::vector<OdometryMeasurement> odometry;  ///< between consecutive keyframes
  /// Accepted once, in the order in which they were; the verdict says what has become of them since.
  std::vector<LoopClosure> closures;
  std::vector<LoopClosure> refusals;  ///< tried and refused
  /// Every frame of odometry, session by session, in the order of time. Maps made without them have none.
  FrameRecords frames;
};

/// What follows is of a new session.
struct SessionStart {
  std::string name;  ///< of the session
};

/// One thing that a back end is given. The same inputs in the same order give the same map, bit for bit.
using MapInput = std::variant<SessionStart, Keyframe, GnssFix, std::vector<FrameRecord>>;

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

/// Carries the graph's corrections at the keyframes over to every pose of odometry between them.
///
/// Between keyframes a and b the correction to their relative pose, E = log((O_a^-1 O_b)^-1 X_a^-1 X_b), is spread
/// evenly over time: X(t) = X_a O_a^-1 O(t) exp(s E), s = (t - t_a) / (t_b - t_a). Before the first and after the last
/// keyframe, poses move rigidly with it. Keyframes keep their optimized poses exactly.
///
/// @param odometry   T_odom_body of every scan of one session, in time order.
/// @param keyframes  that session's keyframes in time order, with T_odom_body and T_map_body.
/// @returns T_map_body at the times of `odometry`; unchanged if there is no keyframe.
/// @throws std::invalid_argument if there are poses to correct that have no times.
[[nodiscard]] inline Trajectory corrected_trajectory(const Trajectory& odometry, std::span<const Keyframe> keyframes) {
  Trajectory corrected = odometry;
  if (keyframes.empty() || odometry.empty()) return corrected;
  if (!odometry.has_times()) throw std::invalid_argument("corrected_trajectory: the trajectory has no times");
  std::size_t next = 0;  // first keyframe later than the pose at hand
  for (std::size_t i = 0; i < odometry.size(); ++i) {
    const Timestamp time = odometry.times[i];
    while (next < keyframes.size() && keyframes[next].time <= time) ++next;
    const Keyframe& a = keyframes[next == 0 ? 0 : next - 1];
    SE3d pose = a.T_map_body * a.T_odom_body.inverse() * odometry.poses[i];
    if (next > 0 && next < keyframes.size()) {
      const Keyframe& b = keyframes[next];
      const SE3d raw = a.T_odom_body.inverse() * b.T_odom_body;
      const SE3d optimized = a.T_map_body.inverse() * b.T_map_body;
      const double share = to_seconds(time - a.time) / to_seconds(b.time - a.time);
      pose = pose * SE3d::exp(share * (raw.inverse() * optimized).log());
    }
    corrected.poses[i] = pose;
  }
  return corrected;
}

}  // namespace chainslam
