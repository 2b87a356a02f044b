#pragma once

#include <filesystem>

#include "datasets/scan_files.hpp"

namespace chainslam::datasets {

/// The folder of a MulRan sequence's scans: Ouster or sensor_data/Ouster in `path`, where it holds .bin files. Empty if
/// there is none.
[[nodiscard]] std::filesystem::path mulran_scans(const std::filesystem::path& path);

/// Adds the samples of MulRan's and HeLiPR's xsens_imu.csv, if there is one; says so if it is the short form without
/// any.
void add_xsens(ScanFiles& parts, const DatasetOptions& options, const std::filesystem::path& path);

}  // namespace chainslam::datasets
