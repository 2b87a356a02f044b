#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "simulator/recorded_drive.hpp"
#include "simulator/simulate.hpp"

namespace chainslam::simulator {

/// What a semi-real drive's folder says beside its scans.
struct RecordedTexts {
  std::string source;                 ///< one line: what is simulated, what is real, and from which files
  std::string options;                ///< of the simulation, written as it is
  std::vector<std::string> imu_rows;  ///< recorded rows `timestamp,gx,gy,gz,ax,ay,az`; the drive's samples if empty
  Trajectory trajectory;              ///< what the drive was made from, ...
  std::vector<Trajectory> others{};   ///< ... and its world
};

/// Writes a semi-real drive as a folder of clouds:
/// `scans/<number>.pcd` (x y z intensity time: seconds since the scan's start, as measured, with the motion's skew),
/// `times.txt` (of the scans' starts), `imu.csv`, `truth.tum` (T_map_body at every scan's end), `T_body_lidar.txt` (the
/// nominal one, 3x4), `README.txt`; `simulation/` with `source.txt`, `options.json`, `trajectory.tum` and, of other
/// drives, `other1.tum` and so on, from which the scans can be made again.
///
/// @param with_scans  whether clouds and times are written.
/// @param directory  made if missing; must be empty.
/// @throws IoError if it is not empty or cannot be written; files already finished are removed.
[[nodiscard]] SimulationReport write_recorded_drive(const RecordedDrive& drive, const RecordedTexts& texts,
                                                    const std::filesystem::path& directory, bool with_scans,
                                                    const ChunkRunner& run_chunks,
                                                    const SimulationProgress& progress = {});

}  // namespace chainslam::simulator
