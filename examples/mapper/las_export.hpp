#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "chainslam/io/atomic_file.hpp"
#include "chainslam/slam/georeference.hpp"
#include "chainslam/slam/slam_map.hpp"

namespace chainslam::mapper {

/// How the scans of one frame of a map are written as LAS.
struct LasExport {
  double voxel_size = 0.2;    ///< metres: the first point of each voxel is written; 0: all points
  GnssFactorOptions earth{};  ///< by which fixes put the frame on the Earth
};

/// Writes the scans of the sessions of one frame as LAS 1.4: in UTM (WGS 84, heights above the ellipsoid) if the fixes
/// of its keyframes say where that is, else in the map's frame. Point source IDs are sessions; times and intensities as
/// the lines that are returned say. Points are not kept: scans are read twice.
/// @returns what the user should know of the file, a line each: "georeference ...", "GPS time ...", "intensity ...".
/// @throws IoError if it cannot be written.
[[nodiscard]] std::vector<std::string> write_las(const FileTarget& target, const SlamMap& map,
                                                 const std::vector<SessionId>& sessions, const LasExport& options);

}  // namespace chainslam::mapper
