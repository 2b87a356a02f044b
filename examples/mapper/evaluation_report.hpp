#pragma once

#include <string>
#include <vector>

#include "chainslam/trajectory/association.hpp"
#include "chainslam/trajectory/kitti_errors.hpp"
#include "chainslam/trajectory/pose_errors.hpp"
#include "trajectory_file.hpp"

namespace chainslam::mapper {

/// One reference and one estimate, and how their poses were joined.
struct EvaluatedSession {
  TrajectoryFile reference;
  TrajectoryFile estimate;
  std::string association;  ///< "time", "index" or "interpolate"
  Index matched = 0;
  UnmatchedCounts reference_left_over;
  UnmatchedCounts estimate_left_over;
  double largest_difference = 0;  ///< seconds between the times of two poses that were joined
};

/// All that `chainslam eval` found out.
struct Evaluation {
  std::vector<EvaluatedSession> sessions;
  AlignmentOptions alignment;
  RpeOptions rpe_options;
  KittiOptions kitti_options;
  std::string delta;  ///< as on the command line
  AbsolutePoseErrors ape;
  RelativePoseErrors rpe;
  KittiErrors kitti;
};

[[nodiscard]] const char* alignment_name(Alignment alignment);

/// The evaluation for a reader.
[[nodiscard]] std::string evaluation_table(const Evaluation& evaluation);

/// The evaluation for a program: `ape.translation.rmse`, `ape.rotation_deg.rmse`, `rpe...`,
/// `kitti.translation_percent`, `kitti.rotation_deg_per_100m`, counts; metres and degrees.
[[nodiscard]] std::string evaluation_json(const Evaluation& evaluation);

}  // namespace chainslam::mapper
