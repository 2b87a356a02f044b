#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>

#include "chainslam/lie/se3.hpp"

namespace chainslam::mapper {

/// The options that a drive can be made again from.
struct DriveChoice {
  std::string lidar;
  int columns;
  double lidar_height;
  std::uint64_t seed;
  bool recorded_imu;
  std::size_t others;  ///< drives through the same world
  bool gnss;
  SE3d T_body_lidar;
};

/// The options as the text of the file that `read_choice` reads.
[[nodiscard]] std::string text_of(const DriveChoice& choice);

/// @throws IoError if the file is not what `text_of` writes, or the command line would not take its values.
[[nodiscard]] DriveChoice read_choice(const std::filesystem::path& path);

}  // namespace chainslam::mapper
