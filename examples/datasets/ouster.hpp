#pragma once

#include <algorithm>
#include <cstddef>
#include <filesystem>
#include <utility>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/sensor/packet.hpp"
#include "datasets/files.hpp"

namespace chainslam::datasets {

/// A scan of an OS1-64 at 10 Hz, whose points come column by column with 64 in each and 1024 columns a turn; a scan may
/// be short.
[[nodiscard]] inline LidarScan ouster_scan(Timestamp start, PointCloud<float> cloud) {
  constexpr std::size_t rings = 64, columns = 1024;
  constexpr double period = 0.1;
  LidarScan scan{.time = start, .end = start, .cloud = std::move(cloud)};
  scan.cloud.time_offsets.clear();
  double last = 0;
  for (std::size_t i = 0; i < scan.cloud.size(); ++i) {
    last = period * static_cast<double>(std::min(i / rings, columns - 1)) / static_cast<double>(columns);
    scan.cloud.time_offsets.push_back(static_cast<float>(last));
  }
  scan.end = start + seconds(last) + Duration(1);  // rounding of the offsets to float
  return scan;
}

/// The times that files' names state. @throws IoError naming a file whose name states none.
[[nodiscard]] inline std::vector<Timestamp> times_of_names(const std::vector<std::filesystem::path>& files) {
  std::vector<Timestamp> times;
  for (const auto& file : files) {
    const auto time = time_of_name(file.stem().string());
    if (!time)
      throw_input_error(file.string(), "", "a name that is no time", "scans are named by the time of their start");
    times.push_back(*time);
  }
  return times;
}

}  // namespace chainslam::datasets
