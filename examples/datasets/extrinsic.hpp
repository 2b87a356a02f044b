#pragma once

#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "chainslam/lie/se3.hpp"
#include "datasets/dataset.hpp"

namespace chainslam::datasets {

/// How people write a pose, for messages.
inline constexpr const char* pose_layouts =
    "x y z roll pitch yaw (metres, degrees; yaw about z, then pitch about the new y, then roll about the new x), "
    "x y z qx qy qz qw, or the 12 or 16 numbers of a 3x4 or 4x4 matrix, row by row";

/// A pose, or what is wrong with the numbers that should be one.
struct PoseNumbers {
  std::optional<SE3d> pose{};
  std::string problem{};
};

/// A pose from 6, 7, 12 or 16 numbers: see `pose_layouts`.
[[nodiscard]] PoseNumbers pose_of_numbers(std::span<const double> numbers);

/// T_body_lidar that a data set's own files state, with the file's name.
struct StatedExtrinsic {
  SE3d T_body_lidar;
  std::string source;
};

/// Reads `T_body_lidar.txt` (a pose in one of `pose_layouts`, p_body = T p_lidar; lines that start with '#' are
/// remarks) or KITTI's `calib_imu_to_velo.txt` (R and T of p_lidar = R p_imu + T) from the first place that has one.
/// @throws IoError naming file and finding if it holds no pose.
[[nodiscard]] std::optional<StatedExtrinsic> find_extrinsic(const std::vector<std::filesystem::path>& places);

/// Sets `info.T_body_lidar`: as given, else as stated, else the identity, and notes where it comes from. Where an IMU
/// is read and nothing states the extrinsic, that is a warning.
void set_extrinsic(const DatasetOptions& options, const std::optional<StatedExtrinsic>& stated, bool has_imu,
                   DatasetInfo& info);

}  // namespace chainslam::datasets
