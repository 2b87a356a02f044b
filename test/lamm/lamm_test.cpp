#include "lamm.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/trajectory/pose_errors.hpp"
#include "simulator/preset.hpp"
#include "simulator/town_drive.hpp"

namespace chainslam::lamm {
namespace {

/// A simulated session, and where it was.
struct TownSession {
  Drive drive;
  Trajectory truth;  ///< at every frame
};

/// A scan in the body frame at its end, corrected for motion by the truth.
PointCloud<float> corrected_scan(const simulator::TownDrive& town, Index index, const SE3d& T_body_lidar) {
  const LidarScan scan = town.scan(index);
  const SE3d T_body_map = town.truth(town.scan_end(index)).inverse();
  PointCloud<float> corrected;
  for (std::size_t i = 0; i < scan.cloud.size(); i += 2) {
    const Timestamp time = scan.time + seconds(static_cast<double>(scan.cloud.time_offsets[i]));
    const Eigen::Vector3d p = T_body_lidar * scan.cloud.positions[i].cast<double>().eval();
    corrected.positions.push_back((T_body_map * town.truth(time) * p).cast<float>());
  }
  return corrected;
}

/// Odometry is the truth with a scale error of 0.3 % and a turn of 0.01 deg a metre, in a frame of its own; a scan is
/// kept every 3 m.
TownSession town_session(const simulator::Preset& preset, std::uint64_t seed, std::size_t number) {
  const simulator::TownDrive town(preset, seed, number);
  TownSession session;
  session.drive.name = "session " + std::to_string(number + 1);
  session.truth = town.truth_at_scan_ends();
  SE3d T_odom_body, last_kept;
  for (std::size_t i = 0; i < session.truth.size(); ++i) {
    if (i > 0) {
      const SE3d step = session.truth.poses[i - 1].inverse() * session.truth.poses[i];
      const double length = step.translation().norm();
      T_odom_body =
          T_odom_body * SE3d(step.rotation() * SO3d::exp({0, 0, 1.7e-4 * length}), 1.003 * step.translation());
    }
    session.drive.odometry.times.push_back(session.truth.times[i]);
    session.drive.odometry.poses.push_back(T_odom_body);
    if (i > 0 && (last_kept.inverse() * T_odom_body).translation().norm() < 3) continue;
    last_kept = T_odom_body;
    session.drive.scans.push_back({.frame = to_index(i),
                                   .cloud = std::make_shared<const PointCloud<float>>(
                                       corrected_scan(town, to_index(i), preset.lidar.T_body_lidar))});
  }
  return session;
}

/// Scans of all drives at the poses that were found for them, and where they were.
MatchedTrajectories matched(const std::vector<TownSession>& sessions, const OptimizedDrives& optimized) {
  MatchedTrajectories all;
  for (std::size_t i = 0; i < sessions.size(); ++i)
    for (std::size_t k = 0; k < optimized.poses[i].size(); ++k) {
      const auto frame = static_cast<std::size_t>(sessions[i].drive.scans[k].frame);
      all.reference.poses.push_back(sessions[i].truth.poses[frame]);
      all.estimate.poses.push_back(optimized.poses[i][k]);
    }
  return all;
}

double joint_ape(const std::vector<TownSession>& sessions, const OptimizedDrives& optimized) {
  const MatchedTrajectories all = matched(sessions, optimized);
  return ape(all.reference, all.estimate).translation.rmse;
}

std::vector<Drive> drives_of(const std::vector<TownSession>& sessions) {
  std::vector<Drive> drives;
  for (const TownSession& session : sessions) drives.push_back(session.drive);
  return drives;
}

/// How far a loop is from the truth, metres.
double error_of(const Loop& loop, const std::vector<TownSession>& sessions) {
  const auto pose = [&](Index session, Index frame) {
    return sessions[static_cast<std::size_t>(session)].truth.poses[static_cast<std::size_t>(frame)];
  };
  const SE3d T = pose(loop.target, loop.target_frame).inverse() * pose(loop.source, loop.source_frame);
  return (T.translation() - loop.T_target_source.translation()).norm();
}

/// Two sessions of one town that share streets, and one of another town.
const std::vector<TownSession>& town_sessions() {
  static const std::vector<TownSession> sessions = [] {
    const simulator::Preset preset = *simulator::preset("town-sessions");
    return std::vector<TownSession>{town_session(preset, 1, 0), town_session(preset, 1, 2), town_session(preset, 8, 1)};
  }();
  return sessions;
}

}  // namespace

TEST_SUITE("lamm") {
  TEST_CASE("two sessions of one town are merged with the right transform, one of another town is left alone") {
    const std::vector<TownSession>& sessions = town_sessions();
    const std::vector<Drive> drives = drives_of(sessions);
    const Result result = merge(drives, {}, ThreadPool(2));
    CHECK(result.drives.report.ok());
    CHECK(result.drives.frame_of == std::vector<Index>{0, 0, 2});
    CHECK(result.counts.pairs == 6);
    const auto between = std::ranges::count_if(
        result.loops, [](const Loop& loop) { return loop.kept && loop.source == 1 && loop.target == 0; });
    CHECK(between >= 10);
    for (const Loop& loop : result.loops)
      if (loop.kept) CHECK(error_of(loop, sessions) < 1.0);
    const std::vector<TownSession> merged(sessions.begin(), sessions.begin() + 2);
    CHECK(joint_ape(merged, result.drives) < 1.0);
  }

  TEST_CASE("any number of threads gives the same") {
    const std::vector<TownSession> sessions(town_sessions().begin(), town_sessions().begin() + 2);
    const std::vector<Drive> drives = drives_of(sessions);
    const Result one = merge(drives, {}, ThreadPool(1)), three = merge(drives, {}, ThreadPool(3));
    REQUIRE(one.loops.size() == three.loops.size());
    REQUIRE(one.drives.poses.size() == three.drives.poses.size());
    for (std::size_t i = 0; i < one.drives.poses.size(); ++i)
      for (std::size_t k = 0; k < one.drives.poses[i].size(); ++k)
        CHECK(one.drives.poses[i][k].matrix() == three.drives.poses[i][k].matrix());
  }

  TEST_CASE("what the released program does gives no better map") {
    const std::vector<TownSession> sessions(town_sessions().begin(), town_sessions().begin() + 2);
    const std::vector<Drive> drives = drives_of(sessions);
    const Result designed = merge(drives, {}, ThreadPool(2)), released = merge(drives, as_released(), ThreadPool(2));
    CHECK(joint_ape(sessions, designed.drives) < joint_ape(sessions, released.drives));
  }

  TEST_CASE("drives without scans, and none at all, are no failure") {
    CHECK(merge({}, {}, ThreadPool(1)).drives.poses.empty());
    const std::vector<Drive> empty(2);
    const Result result = merge(empty, {}, ThreadPool(1));
    CHECK(result.loops.empty());
    CHECK(result.drives.frame_of == std::vector<Index>{0, 1});
  }
}

}  // namespace chainslam::lamm
