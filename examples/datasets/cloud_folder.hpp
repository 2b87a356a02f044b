#pragma once

#include <filesystem>

namespace chainslam::datasets {

/// The folder that holds a cloud folder's files: the path itself, or a folder in it of a usual name (clouds, Scans,
/// velodyne, velodyne_points/data, lidar, scans, pcd, ply). Empty if there is none.
[[nodiscard]] std::filesystem::path folder_of_clouds(const std::filesystem::path& path);

}  // namespace chainslam::datasets
