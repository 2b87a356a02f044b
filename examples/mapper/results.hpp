#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "chainslam/evaluation/ape.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "mapping.hpp"
#include "options.hpp"
#include "support/summary.hpp"

namespace chainslam::mapper {

/// Errors of one trajectory against the truth, after the rigid motion that fits best.
struct TrajectoryErrors {
  AbsolutePoseErrors ape;
  Index left_out = 0;  ///< poses outside of the truth's span
};

/// What is left to say about a run once it is over.
struct RunOutcome {
  MappingResult mapping;
  Trajectory trajectory;  ///< T_map_body of every frame
  std::optional<Trajectory> truth;
  std::optional<TrajectoryErrors> odometry_errors, optimised_errors;
  support::RunSummary summary;
};

/// Corrects the trajectory, takes errors against the truth and judges the goals.
/// @param truth  T_map_body, in any frame of its own; none if there is none.
[[nodiscard]] RunOutcome conclude(MappingResult mapping, std::optional<Trajectory> truth, const std::string& dataset,
                                  const MapperOptions& options);

/// Writes everything but the report and the summary:
/// - `trajectory.tum`, `trajectory.kitti.txt`: T_map_body of every scan; `odometry.tum`: T_odom_body
/// - `map.ply`: all scans, voxelised, map frame
/// - `graph.g2o`: keyframes, odometry and closures with their information
/// - `keyframes.csv`, `closures.csv`: every keyframe; every closure tried, with its verdict
/// @throws IoError
void write_results(const std::filesystem::path& folder, const RunOutcome& outcome, const MapperOptions& options);

/// Writes `report.html` and `map.png`. @throws IoError
void write_run_report(const std::filesystem::path& folder, const RunOutcome& outcome, double map_voxel);

}  // namespace chainslam::mapper
