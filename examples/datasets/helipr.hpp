#pragma once

#include <filesystem>

namespace chainslam::datasets {

/// The folder of a HeLiPR sequence's scans: the one in LiDAR that `sensor` names (Ouster, Velodyne, Aeva or Avia), or
/// the first of these that holds .bin files. Empty if there is none.
[[nodiscard]] std::filesystem::path helipr_scans(const std::filesystem::path& path, const std::string& sensor = {});

}  // namespace chainslam::datasets
