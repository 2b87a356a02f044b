#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <string_view>

#include "chainslam/core/executor.hpp"
#include "simulator/preset.hpp"

namespace chainslam::simulator {

/// What `simulate` made, in all sessions.
struct SimulationReport {
  Index scans = 0;
  std::uint64_t points = 0;  ///< returns in all scans
  double duration = 0.0;     ///< seconds
  double length = 0.0;       ///< of the drives, metres
  std::uint64_t bytes = 0;   ///< of all files
};

/// Called now and then with the scans made so far and in all. If it throws, nothing is left but the empty folder.
using SimulationProgress = std::function<void(Index done, Index total)>;

/// `Executor::for_chunks` without its type, for the compiled part.
using ChunkRunner = std::function<void(Index count, Index grain, const std::function<void(Index, Index)>& body)>;

[[nodiscard]] SimulationReport simulate(const Preset& preset, std::uint64_t seed,
                                        const std::filesystem::path& directory, const ChunkRunner& run_chunks,
                                        const SimulationProgress& progress = {});

/// Writes simulated sessions in the preset's layout.
///
/// NuScenes: see `NuscenesFolder`; beside its tables `truth_session1.tum` ..., as below, and `README.txt`.
///
/// NCLT: a session all files in one folder; several sessions as the folders `session1`,
/// `session2`, ... in it, their truths in one map frame:
/// `velodyne_hits.bin`, `ms25.csv`, `gps.csv`, `groundtruth_<date>.csv` as NCLT has them (z down); `labels.bin`, a
/// `Presence` for each hit, if the preset is labelled; beside them
/// `truth.tum`, T_map_body at the end of every scan (z up, as the library has it), and `README.txt`, which says what it
/// is. The same preset and seed give the same bytes with any executor.
///
/// @param directory  made if missing; must be empty.
/// @throws IoError if it is not empty or cannot be written; files already finished are removed.
template <Executor Exec>
[[nodiscard]] SimulationReport simulate(const Preset& preset, std::uint64_t seed,
                                        const std::filesystem::path& directory, const Exec& executor,
                                        const SimulationProgress& progress = {}) {
  const ChunkRunner run_chunks = [&](Index count, Index grain, const std::function<void(Index, Index)>& body) {
    executor.for_chunks(count, grain, body);
  };
  return simulate(preset, seed, directory, run_chunks, progress);
}

}  // namespace chainslam::simulator
