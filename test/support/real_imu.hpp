#pragma once

#include <array>
#include <cstddef>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "chainslam/sensor/packet.hpp"
#include "support/real_data.hpp"

namespace chainslam::test {

/// A recorded stream of IMU measurements.
struct RealImu {
  std::string name;
  std::vector<ImuSample> samples;
};

/// Columns of a table of numbers, and the time of a row: its column times `time_unit` seconds, or its number's.
struct ImuFileColumns {
  std::size_t gyro, accel, time;
  double time_unit = 1;
  double row_period = 0;  ///< seconds; if not 0, the times that the file states are too coarse to be used
};

/// Rows of numbers, separated by commas or blanks; others are left out.
inline std::vector<ImuSample> read_imu_table(const std::filesystem::path& path, const ImuFileColumns& columns) {
  std::ifstream file(path);
  std::vector<ImuSample> samples;
  for (std::string line; std::getline(file, line);) {
    for (char& c : line) c = c == ',' ? ' ' : c;
    std::istringstream text(line);
    std::vector<double> v;
    for (double number = 0; text >> number;) v.push_back(number);
    if (v.size() < 7) continue;
    const auto vector = [&](std::size_t at) { return Eigen::Vector3d(v[at], v[at + 1], v[at + 2]); };
    const double time = columns.row_period > 0 ? columns.row_period * static_cast<double>(samples.size())
                                               : columns.time_unit * v[columns.time % v.size()];
    samples.push_back({Timestamp::from_seconds(time), vector(columns.gyro), vector(columns.accel)});
  }
  return samples;
}

/// All real recordings that are at hand: a car's over an hour in all, at 100 Hz, and hand-held ones of 50 to 200 Hz.
inline std::vector<RealImu> real_imu_streams() {
  constexpr double frame = 0.1037;  // seconds, of KITTI
  constexpr ImuFileColumns kitti{.gyro = 1, .accel = 4, .time = 0, .time_unit = frame};
  constexpr ImuFileColumns csv{.gyro = 1, .accel = 4, .time = 0};
  const std::string init = "imu/lidar_imu_init/", raw = "kitti00_keyframes_imu/kitti00_keyframes_imu/";
  const std::vector<std::pair<std::string, ImuFileColumns>> files{
      {"kitti_imu/00_imu.csv", kitti},
      {"kitti_imu/05_imu.csv", kitti},
      {"kitti_imu/06_imu.csv", kitti},
      {"kitti_imu/07_imu.csv", kitti},
      {"kitti_imu/09_imu.csv", kitti},
      {"kitti00_first101/kitti00_first101_imu.csv", csv},
      {raw + "kitti00_keyframes_imu/imu.csv", csv},
      {"imu/gtsam_points_continuous/imu.txt", {.gyro = 4, .accel = 1, .time = 0}},
      {init + "imu.txt", {.gyro = 1, .accel = 4, .time = 0, .row_period = 0.005}},
      {init + "IMU_meas.txt", {.gyro = 0, .accel = 4, .time = 10}},
      {init + "IMU_before_filter.txt", {.gyro = 0, .accel = 4, .time = 7}}};
  std::vector<RealImu> streams;
  for (const auto& [name, columns] : files)
    if (const auto path = real_data(name)) streams.push_back({name, read_imu_table(*path, columns)});
  return streams;
}

}  // namespace chainslam::test
