#pragma once

#include <functional>
#include <memory>
#include <span>
#include <stop_token>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/map/slam_map.hpp"
#include "datasets/dataset.hpp"
#include "mapping_result.hpp"
#include "options.hpp"
#include "support/progress.hpp"
#include "support/statistics.hpp"

namespace chainslam::mapper {

/// What a run is given besides the data.
struct MappingRun {
  const MapperOptions& options;
  Index threads = 1;     ///< of the front end and the back end together
  std::stop_token stop;  ///< Ctrl-C: the scan at hand is finished, and the run ends as if the data did
  Index max_scans = 0;   ///< of each data set; 0: all
  support::Progress& progress;
  support::StageTimes& times;  ///< "read", "odometry", "back end", "final optimisation"
  /// Called after each step of the back end, on its thread, with the map as it is: keeps what a crash would lose.
  std::function<void(const SlamMap&)> journal{};
};

/// Maps data sets one after the other on top of maps that were saved before: odometry, keyframes, closures, chains,
/// merges, pose graph.
[[nodiscard]] MappingResult run_mapping(std::span<const std::unique_ptr<datasets::Dataset>> datasets,
                                        std::span<const SlamMap> loaded, const MappingRun& run);

}  // namespace chainslam::mapper
