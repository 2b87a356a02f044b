#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <optional>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/sensor/packet.hpp"
#include "simulator/rig.hpp"
#include "support/real_data.hpp"

namespace chainslam::test {

/// A drive of kitti_imu: KITTI's truth as poses of the IMU, and the measured IMU data outside the filled gaps, both by
/// KITTI's frame times. The IMU lags by about 66 ms.
struct KittiDrive {
  Trajectory trajectory;
  std::vector<ImuSample> imu;
};

namespace internal {

/// The intervals of a sequence, in frames, in which the source drew straight lines for want of measurements.
inline std::vector<std::pair<double, double>> filled_gaps(const std::filesystem::path& path,
                                                          const std::string& sequence) {
  std::vector<std::pair<double, double>> gaps;
  std::ifstream file(path);
  std::string name;
  for (double from = 0.0, to = 0.0; file >> name >> from >> to;)
    if (name == sequence) gaps.emplace_back(from, to);
  return gaps;
}

/// Rows of `nominal_frame,gx,gy,gz,ax,ay,az` (rad/s, m/s^2).
inline std::vector<std::pair<double, ImuSample>> imu_by_frames(const std::filesystem::path& path, double period) {
  std::vector<std::pair<double, ImuSample>> rows;
  std::ifstream file(path);
  std::string line;
  std::getline(file, line);
  while (std::getline(file, line)) {
    std::ranges::replace(line, ',', ' ');
    std::istringstream fields(line);
    auto& [frame, sample] = rows.emplace_back();
    fields >> frame;
    for (int axis = 0; axis < 3; ++axis) fields >> sample.gyro[axis];
    for (int axis = 0; axis < 3; ++axis) fields >> sample.accel[axis];
    sample.time = Timestamp(seconds(frame * period));
  }
  return rows;
}

}  // namespace internal

/// As `chainslam simulate --trajectory NN_truth_camera.txt --imu NN_imu.csv --skip filled.txt` reads it: a drive that
/// begins in a gap begins behind it.
/// @param period  between frames, seconds. @returns nothing if the data are not at hand.
inline std::optional<KittiDrive> kitti_drive(const std::string& sequence, double period) {
  const auto folder = real_data("kitti_imu");
  if (!folder) return std::nullopt;
  const auto gaps = internal::filled_gaps(*folder / "filled.txt", sequence);
  const Trajectory truth = read_kitti_poses(*folder / (sequence + "_truth_camera.txt"));
  const double first = !gaps.empty() && gaps.front().first == 0.0 ? std::ceil(gaps.front().second) : 0.0;
  const SE3d T_camera_imu = simulator::kitti_T_camera_lidar() * simulator::kitti_T_lidar_imu();
  KittiDrive drive;
  for (auto i = static_cast<std::size_t>(first); i < truth.size(); ++i) {
    drive.trajectory.times.push_back(Timestamp(seconds(static_cast<double>(i) * period)));
    drive.trajectory.poses.push_back(T_camera_imu.inverse() * truth.poses[i] * T_camera_imu);
  }
  for (const auto& [frame, sample] : internal::imu_by_frames(*folder / (sequence + "_imu.csv"), period)) {
    const auto lies_in = [&frame = frame](const auto& gap) { return frame >= gap.first && frame <= gap.second; };
    if (std::ranges::none_of(gaps, lies_in)) drive.imu.push_back(sample);
  }
  return drive;
}

}  // namespace chainslam::test
