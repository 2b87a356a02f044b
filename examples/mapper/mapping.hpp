#pragma once

#include <memory>
#include <stop_token>
#include <string>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/map/frame.hpp"
#include "chainslam/map/slam_map.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "datasets/dataset.hpp"
#include "options.hpp"
#include "support/progress.hpp"
#include "support/statistics.hpp"

namespace chainslam::mapper {

/// What a run of the mapper found out.
struct MappingResult {
  std::shared_ptr<const SlamMap> map;
  Trajectory odometry;              ///< T_odom_body of every frame
  std::vector<FrameHealth> health;  ///< one for each frame
  Index scans = 0;                  ///< read
  std::vector<std::string> notes;   ///< what the user should know: scans and points left out, and why
  bool interrupted = false;         ///< the data were not read to their end
};

/// What a run is given besides the data.
struct MappingRun {
  const MapperOptions& options;
  const ThreadPool& threads;
  std::stop_token stop;  ///< Ctrl-C: the scan at hand is finished, and the run ends as if the data did
  Index max_scans = 0;   ///< 0: all
  support::Progress& progress;
  support::StageTimes& times;  ///< "read", "odometry", "back end"
};

/// Reads a data set from its start to its end: odometry, keyframes, closures, pose graph.
[[nodiscard]] MappingResult run_mapping(datasets::Dataset& dataset, const MappingRun& run);

}  // namespace chainslam::mapper
