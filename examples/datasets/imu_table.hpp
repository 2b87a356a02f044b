#pragma once

#include <array>
#include <cstddef>
#include <filesystem>
#include <functional>
#include <optional>
#include <vector>

#include "chainslam/sensor/packet.hpp"
#include "datasets/scan_files.hpp"

namespace chainslam::datasets {

/// Where in a comma-separated table's rows an inertial unit's samples stand, counted from 0.
struct ImuColumns {
  std::size_t time = 0;                      ///< whole nanoseconds or microseconds, or seconds, since 1970 or a start
  std::optional<std::size_t> nanoseconds{};  ///< a column of its own behind whole seconds
  std::array<std::size_t, 3> gyro{1, 2, 3};  ///< EuRoC's order: rates before accelerations
  std::array<std::size_t, 3> accel{4, 5, 6};
  std::size_t named = 0;  ///< columns that the header names; 0 if there is none. A row holds no more than these
};

/// The columns that a table's header names (`gx`, `gyro_x`, `w_RS_S_x [rad s^-1]`, `angular_velocity.x`, `ax`, `acc_x`,
/// `timestamp`, `sec` with `nsec` ...), with or without '#' in front; EuRoC's if it has none.
/// @throws IoError if the header names not all of them.
[[nodiscard]] ImuColumns imu_columns(const std::filesystem::path& path);

/// Adds a table's samples (see `add_imu`). Rows whose numbers are not finite are left out and counted, and those whose
/// time is none between the years 1824 and 2115.
/// Reading throws IoError naming line and field of what is no number, or missing.
void add_imu_table(ScanFiles& parts, const DatasetOptions& options, const std::filesystem::path& path,
                   const ImuColumns& columns);

/// A table of an inertial unit in a folder, by its usual names (imu.csv, imu0/data.csv, ouster_imu.csv ...); empty if
/// there is none.
[[nodiscard]] std::filesystem::path find_imu_table(const std::filesystem::path& folder);

}  // namespace chainslam::datasets
