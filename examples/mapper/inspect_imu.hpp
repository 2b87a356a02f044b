#pragma once

#include <filesystem>
#include <stop_token>

#include "datasets/inspect.hpp"
#include "options.hpp"

namespace chainslam::mapper {

/// Compares the IMU of a data set with the motion of its scans, by LiDAR odometry alone, and adds what that says of
/// clock and axes to an inspection; nothing where scans or IMU are missing.
/// @param seconds  of data, from the start of the scans on.
/// @throws IoError if the data set cannot be read.
void inspect_imu(const std::filesystem::path& path, const MapperOptions& options, double seconds,
                 const std::stop_token& stop, datasets::Inspection& result);

}  // namespace chainslam::mapper
