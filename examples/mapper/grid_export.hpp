#pragma once

#include <filesystem>
#include <string>

#include "chainslam/io/atomic_file.hpp"
#include "chainslam/slam/occupancy_grid.hpp"

namespace chainslam::mapper {

/// The two files of a grid, as ROS's map server reads them (https://wiki.ros.org/map_server).
struct GridFiles {
  std::filesystem::path image;  ///< NAME.pgm
  std::filesystem::path yaml;   ///< NAME.yaml, which names the image
};

/// For NAME, NAME.yaml, NAME.yml or NAME.pgm.
[[nodiscard]] GridFiles grid_files(const std::filesystem::path& path);

/// Cells as a picture (binary PGM, the row with the largest y first): 0 occupied, 254 free, 205 not known or not sure.
/// @throws IoError
void write_grid_image(const FileTarget& target, const OccupancyGrid<>& grid);

/// What the map server needs to know of the picture. @param image  its name, in the same folder. @throws IoError
void write_grid_yaml(const FileTarget& target, const OccupancyGrid<>& grid, const std::string& image);

}  // namespace chainslam::mapper
