#pragma once

#include <functional>
#include <memory>
#include <span>
#include <stop_token>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "chainslam/factor_graph/smoother_reports.hpp"
#include "chainslam/slam/closure_descent.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "datasets/dataset.hpp"
#include "mapping_result.hpp"
#include "options.hpp"
#include "support/progress.hpp"
#include "support/statistics.hpp"

namespace chainslam::mapper {

/// What a run is given besides the data.
struct MappingRun {
  const MapperOptions& options;
  Index threads = 1;             ///< of the front end and the back end together
  std::stop_token stop{};        ///< Ctrl-C: the scan at hand is finished, and the run ends as if the data did
  Index max_scans = 0;           ///< of each data set; 0: all
  std::uint64_t max_memory = 0;  ///< bytes of the process, at which the run ends as if the data did; 0: any
  support::Progress& progress;
  support::StageTimes& times;  ///< "read", "odometry", "journal", "back end", "GNSS fixes", "end of session" and others
  /// Called with what the back end gets next, before it does, on a thread of its own: once it has returned, no crash
  /// loses that. At the latest for each 0.4 s of data, and the front end is never more than a second ahead; of recorded
  /// odometry, for at most 16 keyframes.
  std::function<void(std::span<const MapInput>)> record{};
  /// Called after each step of the back end, on its thread, with the map as it is.
  std::function<void(const SlamMap&)> journal{};
};

/// Whether the process has more in memory than the run allows.
[[nodiscard]] bool memory_is_full(const MappingRun& run);

/// Maps data sets one after the other on top of maps that were saved before: odometry, keyframes, closures, chains,
/// merges, pose graph.
[[nodiscard]] MappingResult run_mapping(std::span<const std::unique_ptr<datasets::Dataset>> datasets,
                                        std::vector<SlamMap> loaded, const MappingRun& run);

/// Does the back end's work of a run again. @returns the map that the run would have had, bit for bit.
[[nodiscard]] std::shared_ptr<const SlamMap> run_again(std::vector<MapInput> inputs, std::vector<SlamMap> loaded,
                                                       const MappingRun& run);

/// Decides again what a map's sessions, keyframes, frames and fixes come to; closures that were undone are not found
/// again. @returns the map that a run with these settings would have had, bit for bit.
[[nodiscard]] std::shared_ptr<const SlamMap> map_again(const SlamMap& map, const UndoneClosures& undone,
                                                       const MappingRun& run);

/// A session of a saved map that a back end is given again.
struct ReplayedSession {
  const SlamMap* map;
  SessionId session;
};

/// Maps sessions of saved maps on top of a first one, which may be empty: closures, chains and merges are decided as in
/// `run_mapping`. @returns the map that a run which loads the first and maps these sessions' data would have, bit for
/// bit, if they were mapped with these settings.
[[nodiscard]] std::shared_ptr<const SlamMap> map_onto(const SlamMap& first, std::span<const ReplayedSession> sessions,
                                                      const MappingRun& run);

/// Brings a map to the exact optimum of its measurements, without trying a scan. @returns how that ended.
[[nodiscard]] ConvergeReport optimize_map(SlamMap& map, const BackEndParts& parts);

}  // namespace chainslam::mapper
