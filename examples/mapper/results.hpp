#pragma once

#include <filesystem>
#include <future>
#include <optional>
#include <string>
#include <vector>

#include "chainslam/trajectory/inter_session.hpp"
#include "chainslam/trajectory/kitti_errors.hpp"
#include "chainslam/trajectory/pose_errors.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "mapping_result.hpp"
#include "options.hpp"
#include "output.hpp"
#include "support/report_data.hpp"
#include "support/summary.hpp"

namespace chainslam::mapper {

/// Errors of one trajectory against the truth, after the rigid motion that fits best.
struct TrajectoryErrors {
  AbsolutePoseErrors ape;
  KittiErrors kitti;   ///< of paths longer than 100 m
  Index left_out = 0;  ///< poses outside of the truth's span
};

/// Errors of all sessions that have a truth, together.
struct JointErrors {
  ErrorStatistics translation;  ///< metres
  ErrorStatistics rotation;     ///< radians
  KittiErrors kitti;            ///< over the segments of all sessions
  Index sessions = 0;
  Index alignments = 0;  ///< rigid motions that were fitted: one if all sessions lie in one frame
};

/// What came out for one session of `MappingResult::sessions`.
struct SessionOutcome {
  Trajectory trajectory;                             ///< T_map_body of every frame
  std::optional<TrajectoryErrors> odometry_errors;   ///< the front end alone, under an alignment of its own
  std::optional<TrajectoryErrors> optimized_errors;  ///< under an alignment of its own
  std::optional<SE3d> T_map_truth;                   ///< by the joint alignment of the frame that the session is in
};

/// What is left to say about a run once it is over.
struct RunOutcome {
  MappingResult mapping;
  std::vector<SessionOutcome> sessions;  ///< as many as `mapping.sessions`
  /// The front end alone: every session's odometry under an alignment of its own.
  std::optional<JointErrors> odometry_errors;
  /// Sessions that lie in one frame share one alignment, so that errors between them count.
  std::optional<JointErrors> optimized_errors;
  /// Between keyframes of different sessions that stood at one place; none if there are no such pairs.
  std::optional<RelativePoseErrors> inter_session_errors;
  support::RunSummary summary;
};

/// Corrects the trajectories, takes errors against the truths and judges the goals.
/// @param dataset  what was mapped, as the title says it.
[[nodiscard]] RunOutcome conclude(MappingResult mapping, const std::string& dataset, const MapperOptions& options);

/// Writes everything but the report and the summary:
/// - `trajectory.tum`, `trajectory.kitti.txt`: T_map_body of every scan; `odometry.tum`: T_odom_body. Of several
///   sessions `trajectory.<session>.tum` and so on, and a joint `trajectory.tum` if their times do not collide.
/// - `map.ply`: all scans, voxelised, map frame
/// - `graph.g2o`: keyframes, odometry and closures with their information
/// - `keyframes.csv`, `closures.csv`: every keyframe; every closure tried, with its verdict
/// - `frames.csv`: every frame's status, what it rests on, and the covariance of its pose
/// What cannot be written is reported, and the rest is written.
void write_results(OutputFolder& folder, const RunOutcome& outcome, const MapperOptions& options);

/// Writes `map.ply` of the first session's frame, and `map.N.ply` of each other frame, as `write_results` does.
void write_map_clouds(OutputFolder& folder, const SlamMap& map, double map_voxel);

/// What the report shows of a map, which outlives it: takes a pass over all scans, as `write_map_clouds` does.
/// @param now  on a thread of its own, while other results are written; else where it is asked for
[[nodiscard]] std::future<support::ReportData> gather_report(const SlamMap& map, double map_voxel, bool now);

/// Writes `map.png` and `report.html`, as `write_results` does. The report links what is in the folder by then.
void write_run_report(OutputFolder& folder, const RunOutcome& outcome, support::ReportData data);

}  // namespace chainslam::mapper
