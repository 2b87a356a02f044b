#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "chainslam/lie/se3.hpp"
#include "chainslam/sensor/packet.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

/// A recorded drive to simulate scans on: real motion and, where it was recorded, real IMU data.
struct RecordedInput {
  Trajectory trajectory;  ///< T_map_body, on the drive's clock
  SE3d T_body_lidar;
  std::vector<Trajectory> others{};   ///< T_map_body of the other drives through the same world
  std::vector<ImuSample> imu;         ///< on the same clock; empty if none was given
  std::vector<std::string> imu_rows;  ///< the same as text: time, then the six values as they were in the file
  std::size_t imu_dropped = 0;        ///< rows left out, because they lie in skipped intervals or beyond the trajectory
};

/// An interval of the drive's clock, seconds.
struct SkippedInterval {
  double from = 0.0;
  double to = 0.0;
};

/// Reads the trajectory that the arguments name, turns it into T_map_body and cuts it where skipped intervals touch its
/// ends; then the IMU rows inside what is left and outside skipped intervals; and the other drives' trajectories, as
/// they are.
///
/// The drive's clock is the trajectory's; KITTI's rows, which have no times, get those of `--times`, or 0 s for the
/// first and 1 / rate from row to row.
/// @throws IoError or support::ConfigError: no times, times that go back, jumps, gaps, too few poses, missing extrinsic
/// calibration, IMU rows without overlap.
[[nodiscard]] RecordedInput read_recorded_input(const SimulateArguments& arguments);

/// Refuses what no vehicle does, and what is too short to be a drive. @throws IoError naming the pose.
void check_drive(const Trajectory& trajectory, const std::filesystem::path& path);

/// Reads intervals: "FROM:TO" in seconds, or a file with rows `FROM TO` in seconds or, as kitti_imu's filled.txt,
/// `SEQUENCE FROM TO` in frames, of which those count whose sequence the trajectory's name begins with.
/// @param frame_times  of KITTI's frames; empty if the trajectory has times of its own.
[[nodiscard]] std::vector<SkippedInterval> read_skipped(const SimulateArguments& arguments,
                                                        const std::vector<Timestamp>& frame_times);

/// Time of a frame number with a fraction; goes on evenly beyond the ends, by a million frames at most.
/// @param frame_times  two or more.
[[nodiscard]] Timestamp time_of_frame(const std::vector<Timestamp>& frame_times, double frame);

/// Reads rows `timestamp,gx,gy,gz,ax,ay,az` (seconds) or `nominal_frame,...` into `input`.
void read_recorded_imu(const SimulateArguments& arguments, const std::vector<Timestamp>& frame_times,
                       const std::vector<SkippedInterval>& skipped, RecordedInput& input);

}  // namespace chainslam::mapper
