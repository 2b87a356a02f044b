#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <numbers>
#include <utility>
#include <vector>

#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/random.hpp"
#include "chainslam/slam/back_end.hpp"
#include "mapper/presets.hpp"
#include "simulator/gnss_receiver.hpp"
#include "simulator/preset.hpp"
#include "simulator/town_drive.hpp"

// Sessions of simulated worlds that are merged by the mapper's default back end: scans as the simulator has them, laid
// straight by the truth, odometry that drifts, and fixes that are as the simulator has them, or wrong.

namespace chainslam::test {

/// What a session gives a back end, and where it truly was.
struct SimulatedSession {
  std::vector<Keyframe> keyframes;  ///< T_odom_body drifts
  std::vector<SE3d> truth;          ///< T_world_body of each
  std::vector<GnssFix> fixes;
};

/// How fixes are wrong.
enum class FixFault {
  none,
  scattered,  ///< three in ten are off by 50 m, each in another direction
  biased  ///< all of every session but the first are off by one shift of about 200 m, onto another part of the first
};

struct WorldOptions {
  double spacing = 3.0;           ///< metres between keyframes
  double voxel = 0.4;             ///< metres, of their scans
  double drift_per_metre = 0.01;  ///< standard deviation of a step of odometry over its length,
  double turn_per_metre = 5e-4;   ///< and of its rotation, radians over metres
};

/// One session of a preset, keyframe by keyframe.
[[nodiscard]] inline SimulatedSession simulated_session(const simulator::Preset& preset, std::uint64_t seed,
                                                        std::size_t number, const WorldOptions& options = {}) {
  const simulator::TownDrive drive(preset, seed, number);
  SimulatedSession session;
  Rng rng(1000 * seed + number);
  SE3d T_odom_body;
  for (Index scan = 0; scan < drive.scan_count(); ++scan) {
    const Timestamp time = drive.scan_end(scan);
    const SE3d T_world_body = drive.truth(time);
    if (!session.truth.empty()) {
      const SE3d step = session.truth.back().inverse() * T_world_body;
      const double length = step.translation().norm();
      if (length < options.spacing) continue;
      Vector6d error;
      for (int k = 0; k < 6; ++k)
        error[k] = rng.normal(0, (k < 3 ? options.drift_per_metre : options.turn_per_metre) * length);
      T_odom_body = T_odom_body * step.retract(error);
    }
    PointCloud<float> cloud;
    const LidarScan seen = drive.scan(scan);
    for (std::size_t i = 0; i < seen.cloud.size(); ++i) {
      const Timestamp then = seen.time + seconds(static_cast<double>(time_offset(seen.cloud, i)));
      const SE3d T_body_lidar = T_world_body.inverse() * drive.truth(then) * drive.lidar().true_T_body_lidar();
      cloud.positions.push_back((T_body_lidar * position(seen.cloud, i)).cast<float>());
    }
    Keyframe keyframe;
    keyframe.time = time;
    keyframe.T_odom_body = T_odom_body;
    keyframe.cloud = std::make_shared<const PointCloud<float>>(voxel_downsample(cloud, options.voxel));
    session.keyframes.push_back(std::move(keyframe));
    session.truth.push_back(T_world_body);
  }
  for (const simulator::GnssReading& reading : drive.gnss())
    if (reading.mode != 0) session.fixes.push_back(reading.fix);
  return session;
}

/// The sessions with fixes that are wrong.
[[nodiscard]] inline std::vector<SimulatedSession> with_fault(std::vector<SimulatedSession> sessions, FixFault fault,
                                                              std::uint64_t seed) {
  Rng rng(seed);
  const auto ecef = [](const Eigen::Vector3d& p) { return simulator::map_to_ecef(p); };
  const auto shift = [&](GnssFix& fix, const Eigen::Vector3d& by) { fix.position_ecef += ecef(by) - ecef({0, 0, 0}); };
  for (std::size_t s = 0; s < sessions.size(); ++s) {
    SimulatedSession& session = sessions[s];
    if (fault == FixFault::scattered)
      for (GnssFix& fix : session.fixes)
        if (rng.uniform() < 0.3) {
          const double direction = rng.uniform(0, 2 * std::numbers::pi);
          shift(fix, 50 * Eigen::Vector3d(std::cos(direction), std::sin(direction), 0));
        }
    if (fault != FixFault::biased || s == 0) continue;
    const Eigen::Vector3d middle = session.truth[session.truth.size() / 2].translation();
    Eigen::Vector3d bias = Eigen::Vector3d::Zero();
    for (const SE3d& there : sessions.front().truth) {
      const Eigen::Vector3d way = there.translation() - middle;
      if (std::abs(way.norm() - 200) < std::abs(bias.norm() - 200)) bias = {way.x(), way.y(), 0};
    }
    for (GnssFix& fix : session.fixes) shift(fix, bias);
  }
  return sessions;
}

/// What became of the sessions.
struct MergeOutcome {
  Index sessions = 0;  ///< that could be merged: but for the first
  Index right = 0;     ///< of these, in the first one's frame and where they were, within 2 m where they come nearest
  Index wrong = 0;     ///< in a frame of others, elsewhere
  Index reverted = 0;  ///< times that a merge was taken back
  Index tried = 0;     ///< attempts at a place
  Index against_fixes = 0;
  double worst = 0;  ///< metres that a right one is off there

  MergeOutcome& operator+=(const MergeOutcome& other) {
    sessions += other.sessions;
    right += other.right;
    wrong += other.wrong;
    reverted += other.reverted;
    tried += other.tried;
    against_fixes += other.against_fixes;
    worst = std::max(worst, other.worst);
    return *this;
  }
};

/// How far off the map has two sessions from each other where they truly come nearest, metres.
[[nodiscard]] inline double off_at_meeting(const SlamMap& map, const std::vector<SE3d>& truth, const Session& a,
                                           const Session& b) {
  double least = std::numeric_limits<double>::infinity(), off = 0;
  for (Index i = a.first_keyframe; i < a.end_keyframe(); ++i)
    for (Index j = b.first_keyframe; j < b.end_keyframe(); ++j) {
      const auto k = static_cast<std::size_t>(i), l = static_cast<std::size_t>(j);
      const SE3d T_i_j = truth[k].inverse() * truth[l];
      if (T_i_j.translation().norm() >= least) continue;
      least = T_i_j.translation().norm();
      const SE3d ours = map.keyframes[k].T_map_body.inverse() * map.keyframes[l].T_map_body;
      off = (T_i_j.inverse() * ours).translation().norm();
    }
  return off;
}

/// Maps sessions by the mapper's default back end and compares with the truth.
[[nodiscard]] inline MergeOutcome merged(const std::vector<SimulatedSession>& sessions,
                                         const mapper::BackEndParts& parts = {}) {
  using Closer = LoopCloser<ProximityCandidates, mapper::ClosureRegistration, mapper::ClosureNoise>;
  using Merger = MapMerger<GnssCandidates, mapper::MergeRegistration>;
  BackEnd<Closer, ChainedCloser, Merger> back_end(
      parts.back_end, Closer(parts.closures, parts.candidates, parts.registration, parts.noise),
      ChainedCloser(parts.chain), Merger(parts.merge, GnssCandidates(parts.gnss), parts.merging), parts.outliers);
  std::vector<SE3d> truth;
  for (const SimulatedSession& session : sessions) {
    back_end.begin_session({});
    std::size_t next = 0;
    const auto fixes_until = [&](Timestamp time) {
      while (next < session.fixes.size() && session.fixes[next].time <= time) back_end.add(session.fixes[next++]);
    };
    for (const Keyframe& keyframe : session.keyframes) {
      fixes_until(keyframe.time);
      back_end.add(keyframe);
    }
    if (next < session.fixes.size()) fixes_until(session.fixes.back().time);
    truth.insert(truth.end(), session.truth.begin(), session.truth.end());
  }
  const auto map = back_end.finish();
  MergeOutcome outcome{.sessions = to_index(sessions.size()) - 1, .reverted = back_end.counts().reverted};
  for (const Session& session : map->sessions) {
    if (session.frame == session.id) continue;
    const double off =
        off_at_meeting(*map, truth, map->sessions[static_cast<std::size_t>(session.frame.value)], session);
    if (off >= 2) {
      ++outcome.wrong;
      continue;
    }
    outcome.right += session.frame == SessionId{0} ? 1 : 0;
    outcome.worst = std::max(outcome.worst, off);
  }
  for (const auto* list : {&map->closures, &map->refusals})
    for (const LoopClosure& closure : *list) {
      outcome.tried += closure.kind == ClosureKind::merge ? 1 : 0;
      outcome.against_fixes += closure.verdict == ClosureVerdict::against_fixes ? 1 : 0;
    }
  return outcome;
}

}  // namespace chainslam::test
