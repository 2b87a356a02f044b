#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "chainslam/core/types.hpp"
#include "support/statistics.hpp"

namespace chainslam::support {

/// A bound that the configuration set, and what came out.
struct GoalResult {
  std::string name{};
  double bound = 0.0;
  double value = 0.0;
  bool met = false;
};

/// What a run came to, in figures that scripts can read.
struct RunSummary {
  std::string dataset{};
  bool interrupted = false;     ///< the data were not read to their end
  Index scans = 0;              ///< given to odometry
  Index frames = 0;             ///< answered by odometry
  Index lost_frames = 0;        ///< of these, without a match in the map
  Index degenerate_frames = 0;  ///< of these, with directions that the scan says nothing about
  Index keyframes = 0;
  Index sessions = 0;
  Index merges = 0;
  Index direct_closures = 0;
  Index chained_closures = 0;
  std::map<std::string, Index> refusals{};  ///< by reason
  double data_seconds = 0.0;                ///< time that the data spans
  double wall_seconds = 0.0;                ///< time that the run took
  double path_length = 0.0;                 ///< metres, all sessions
  std::uint64_t peak_memory = 0;            ///< bytes
  std::vector<StageTime> stages{};
  std::map<std::string, double> errors{};  ///< "optimised.ape.translation.rmse", ...; each dot is a level
  std::vector<GoalResult> goals{};
  std::vector<std::string> notes{};
};

/// The summary as JSON text: `scans`, `keyframes`, `closures.direct`, `closures.chained`, `refusals.<reason>`,
/// `stages.<name>.p50_ms`, `peak_memory_bytes`, `errors...` and so on. A figure that is not finite is null.
[[nodiscard]] std::string summary_json(const RunSummary& summary);

/// Writes `summary_json` to a file that appears whole or not at all. @throws IoError
void write_summary(const std::filesystem::path& path, const RunSummary& summary);

}  // namespace chainslam::support
