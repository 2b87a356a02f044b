#pragma once

#include <algorithm>
#include <array>
#include <memory>
#include <utility>

#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"
#include "simulator/lidar_model.hpp"
#include "simulator/recorded_drive.hpp"
#include "simulator/rig.hpp"
#include "support/kitti_drive.hpp"
#include "support/real_drives.hpp"

namespace chainslam::test {

/// A drive of kitti_imu: its number in KITTI's odometry benchmark, and the seconds from frame to frame.
struct KittiSequence {
  const char* name;
  double period;
};
inline constexpr std::array<KittiSequence, 5> kitti_imu_sequences{
    {{"00", 0.10365}, {"05", 0.1044}, {"06", 0.1042}, {"07", 0.1040}, {"09", 0.1039}}};

/// A semi-real drive: simulated scans on a real trajectory with the IMU data recorded on it, as
/// `chainslam simulate --trajectory` makes it by default. Nothing if the data are not at hand.
inline std::unique_ptr<simulator::RecordedDrive> semi_real_drive(const KittiSequence& sequence) {
  auto recorded = kitti_drive(sequence.name, sequence.period);
  if (!recorded) return nullptr;
  simulator::RecordedDriveOptions options;
  options.lidar.firings_per_revolution = 1026;  // 1024 in whole packets
  options.lidar.T_body_lidar = simulator::kitti_T_lidar_imu().inverse();
  return std::make_unique<simulator::RecordedDrive>(recorded->trajectory, std::move(recorded->imu), options);
}

/// Whether an error is no worse than another one of 20 s of a drive. Chance makes them differ by up to 2 cm or 5 %, the
/// larger: that much is allowed.
inline bool no_worse(double error, double other) { return error <= other + std::max(0.02, 0.05 * other); }

/// The drive without its scans, which are many: the reference for all of it.
inline Drive without_scans(const simulator::RecordedDrive& semi_real) {
  Drive drive;
  drive.T_body_lidar = semi_real.options().lidar.T_body_lidar;
  drive.reference = semi_real.truth_at_scan_ends();
  for (SE3d& pose : drive.reference.poses) pose = pose * drive.T_body_lidar;
  return drive;
}

/// As if the recording had begun with scan `first` and ended `count` scans later.
inline Drive part_of(const simulator::RecordedDrive& semi_real, Index first, Index count) {
  Drive drive = without_scans(semi_real);
  for (Index i = first; i < first + count; ++i) drive.scans.push_back(semi_real.scan(i));
  for (const ImuSample& sample : semi_real.imu())
    if (sample.time >= drive.scans.front().time && sample.time <= drive.scans.back().end) drive.imu.push_back(sample);
  return drive;
}

}  // namespace chainslam::test
