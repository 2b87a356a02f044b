#pragma once

#include <filesystem>
#include <string>

#include "chainslam/core/types.hpp"
#include "chainslam/trajectory/trajectory.hpp"

namespace chainslam::mapper {

enum class TrajectoryFormat { tum, kitti, euroc_csv, nclt_csv };

[[nodiscard]] const char* format_name(TrajectoryFormat format);

/// A trajectory and where it came from.
struct TrajectoryFile {
  std::filesystem::path path;
  TrajectoryFormat format = TrajectoryFormat::tum;
  Trajectory trajectory;
  Index repeated = 0;    ///< poses left out because their stamp was that of the one before
  Index not_finite = 0;  ///< rows left out because they hold NaN (NCLT's truth, as stated, has some)
};

/// Tells a trajectory's format by its first row: 12 numbers are KITTI's poses, 8 are TUM's `t x y z qx qy qz qw`; with
/// commas, 7 are NCLT's ground truth `utime,x,y,z,roll,pitch,heading` and 8 or more EuRoC's.
/// @throws IoError if the row is none of these or there is no row.
[[nodiscard]] TrajectoryFormat trajectory_format(const std::filesystem::path& path);

/// What NCLT's ground truth is to say.
enum class NcltPoses {
  stated,  ///< the file's own poses: map and body with z down, body where NCLT puts it
  imu      ///< those that this program's maps have: z up, body = the inertial unit
};

/// Reads a trajectory of any of these formats.
/// @throws IoError as the format's reader.
[[nodiscard]] TrajectoryFile read_trajectory(const std::filesystem::path& path,
                                             NcltPoses nclt_poses = NcltPoses::stated);

}  // namespace chainslam::mapper
