#pragma once

#include <filesystem>

namespace chainslam::datasets {

/// The folder of a Newer College sequence's scans: raw_format/ouster_scan or ouster_scan in `path`, where it holds
/// clouds named cloud_<sec>_<nsec>.pcd. Empty if there is none.
[[nodiscard]] std::filesystem::path newer_college_scans(const std::filesystem::path& path);

}  // namespace chainslam::datasets
