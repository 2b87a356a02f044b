#pragma once

#include <filesystem>
#include <fstream>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "chainslam/io/kitti.hpp"
#include "chainslam/sensor/imu_sample.hpp"
#include "simulator/rig.hpp"
#include "support/real_data.hpp"

namespace chainslam::test {

/// A drive of kitti_imu: KITTI's truth as poses of the IMU, and the measured IMU data outside the filled gaps.
struct KittiDrive {
  Trajectory trajectory;
  std::vector<ImuSample> imu;
};

/// @param period  between frames, seconds. @returns nothing if the data are not at hand.
inline std::optional<KittiDrive> kitti_drive(const std::string& sequence, double period) {
  const auto folder = real_data("kitti_imu");
  if (!folder) return std::nullopt;
  KittiDrive drive{read_kitti_poses(*folder / (sequence + "_truth_camera.txt")), {}};
  const SE3d T_camera_imu = simulator::kitti_T_camera_lidar() * simulator::kitti_T_lidar_imu();
  for (std::size_t i = 0; i < drive.trajectory.size(); ++i) {
    SE3d& pose = drive.trajectory.poses[i];
    pose = T_camera_imu.inverse() * pose * T_camera_imu;
    drive.trajectory.times.push_back(Timestamp(seconds(static_cast<double>(i) * period)));
  }
  std::vector<std::pair<double, double>> filled;
  std::ifstream gaps(*folder / "filled.txt");
  std::string name;
  for (double from = 0.0, to = 0.0; gaps >> name >> from >> to;)
    if (name == sequence) filled.emplace_back(from - 5.0, to + 5.0);  // the truth is a straight line there, too
  std::ifstream rows(*folder / (sequence + "_imu.csv"));
  std::string line;
  std::getline(rows, line);
  while (std::getline(rows, line)) {
    for (char& c : line) c = c == ',' ? ' ' : c;
    std::istringstream fields(line);
    double frame = 0.0;
    ImuSample sample;
    fields >> frame;
    for (int axis = 0; axis < 3; ++axis) fields >> sample.gyro[axis];
    for (int axis = 0; axis < 3; ++axis) fields >> sample.accel[axis];
    sample.time = Timestamp(seconds(frame * period));
    bool measured = true;
    for (const auto& [from, to] : filled) measured = measured && (frame < from || frame > to);
    if (measured) drive.imu.push_back(sample);
  }
  return drive;
}

}  // namespace chainslam::test
