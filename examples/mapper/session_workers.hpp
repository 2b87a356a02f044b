#pragma once

#include <cstddef>
#include <filesystem>
#include <memory>
#include <span>
#include <vector>

#include "datasets/dataset.hpp"
#include "mapping_result.hpp"

namespace chainslam::mapper {

struct MappingRun;

/// Computes the odometry of a run's sessions elsewhere: in other processes, on other machines. The run itself maps what
/// they have recorded, in the order of its sessions, and has the map that it would have had without them, bit for bit.
class SessionWorkers {
 public:
  SessionWorkers() = default;
  SessionWorkers(const SessionWorkers&) = delete;
  SessionWorkers& operator=(const SessionWorkers&) = delete;
  virtual ~SessionWorkers() = default;

  /// Starts, and replaces each data set whose odometry is computed by one that has that odometry as soon as it is
  /// there: reading it waits.
  /// @param given  what the command line calls the data sets. @param out  where the run's results will be.
  virtual void begin(std::vector<std::unique_ptr<datasets::Dataset>>& datasets,
                     std::span<const std::filesystem::path> given, const MappingRun& run,
                     const std::filesystem::path& out) = 0;

  /// Adds to a session, which has been mapped, what its recording does not say.
  virtual void complete(std::size_t session, SessionRun& run) = 0;

  /// The map of all sessions is saved: nothing that was recorded for it is needed any more.
  virtual void map_saved() = 0;
};

}  // namespace chainslam::mapper
