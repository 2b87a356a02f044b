#pragma once

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <string>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/io/input_file.hpp"
#include "chainslam/io/pcd.hpp"
#include "chainslam/io/ply.hpp"
#include "chainslam/io/trajectory_file.hpp"

namespace chainslam {

/// Reads a point cloud in the format that the name's ending states: `.pcd`, `.ply`, or KITTI's `.bin` (capitals, too).
///
/// @returns n points in the file's frame and unit (metres by convention), with normals, intensities and time offsets
/// where the file has them.
/// @throws IoError as `read_pcd`, `read_ply` and `read_kitti_bin`, and for any other ending.
[[nodiscard]] inline PointCloud<float> read_cloud(const std::filesystem::path& path) {
  std::string ending = path.extension().string();
  std::transform(ending.begin(), ending.end(), ending.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  if (ending == ".pcd") return read_pcd(path);
  if (ending == ".ply") return read_ply(path);
  if (ending == ".bin") return read_kitti_bin(path);
  throw_input_error(path.string(), "the name", "the ending '" + ending + "'", "give a .pcd, .ply or .bin file");
}

}  // namespace chainslam
