#pragma once

#include <algorithm>
#include <cstddef>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "support/drive_run.hpp"
#include "support/real_drives.hpp"

// Real drives that several tests of this program follow: read once, and followed once with the settings that users get.

namespace chainslam::test {

inline const std::optional<Drive>& first101() {
  static const std::optional<Drive> drive = kitti00_first101();
  return drive;
}
inline const std::optional<Drive>& raw_sweeps() {
  static const std::optional<Drive> drive = kitti00_keyframes();
  return drive;
}
inline const std::optional<Drive>& snapshots() {
  static const std::optional<Drive> drive = kitti00_keyframes(PointTimes::none);
  return drive;
}

inline Drive without_imu(Drive drive) {
  drive.imu.clear();
  return drive;
}

/// The first scans of a drive, and the rows of the IMU until the last one's end: all are fed.
inline Drive beginning_of(Drive drive, std::size_t scans) {
  drive.scans.resize(std::min(scans, drive.scans.size()));
  std::erase_if(drive.imu, [&](const ImuSample& row) { return row.time > drive.scans.back().end; });
  return drive;
}

enum class Feed { all, scans_alone };

/// What an odometry makes of a drive, which has to be one of the above.
template <class Odometry>
const DriveRun& shared_run(const Drive& shared, Feed feed = Feed::all) {
  static std::map<std::pair<const Drive*, Feed>, DriveRun> runs;
  const auto [run, added] = runs.try_emplace({&shared, feed});
  if (added) {
    typename Odometry::Options options;
    options.T_body_lidar = shared.T_body_lidar;
    run->second = run_drive<Odometry>(feed == Feed::all ? shared : without_imu(shared), options);
  }
  return run->second;
}

}  // namespace chainslam::test
