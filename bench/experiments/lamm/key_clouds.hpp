#pragma once

#include <algorithm>
#include <cstddef>
#include <memory>
#include <utility>
#include <vector>

#include "chainslam/cloud/transform.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/types.hpp"
#include "drive.hpp"
#include "place_descriptor.hpp"

namespace chainslam::lamm {

/// Which scans are put together to a key cloud.
struct KeyCloudOptions {
  double voxel_size = 0.25;  ///< metres, of each scan before it is put with the others
  Index scans = 10;          ///< of a key cloud
  Index step = 3;            ///< scans from the first of one key cloud to the first of the next
};

/// Some scans in a row, described in the body frame of the first.
struct KeyCloud {
  Index frame = 0;   ///< of the drive, of its first scan
  Index number = 0;  ///< what LAMM counts it as: frames since the start of the first drive, over the frames of a key cloud
  std::shared_ptr<const PlaceDescriptor> place{};
};

/// The scans of a drive from `first` on, in the body frame of the first.
[[nodiscard]] inline PointCloud<float> accumulated(const Drive& drive, std::size_t first,
                                                   const KeyCloudOptions& options) {
  const std::size_t end = std::min(drive.scans.size(), first + static_cast<std::size_t>(options.scans));
  const SE3d T_first_odom = drive.pose(drive.scans[first].frame).inverse();
  PointCloud<float> cloud;
  for (std::size_t i = first; i < end; ++i) {
    const Scan& scan = drive.scans[i];
    const PointCloud<float> thinned = voxel_downsample(*scan.cloud, options.voxel_size);
    const PointCloud<float> moved = transformed(thinned.positions, T_first_odom * drive.pose(scan.frame));
    cloud.positions.insert(cloud.positions.end(), moved.positions.begin(), moved.positions.end());
  }
  return cloud;
}

/// The described key clouds of a drive.
/// @param frames_before  of the drives before this one.
/// @param frames_per_number  frames in a row that LAMM makes a key cloud of.
template <Executor Exec>
[[nodiscard]] std::vector<KeyCloud> key_clouds(const Drive& drive, const KeyCloudOptions& options,
                                               const PlaceDescriptorOptions& place, Index frames_before,
                                               Index frames_per_number, const Exec& executor) {
  std::vector<KeyCloud> clouds;
  for (std::size_t first = 0; first < drive.scans.size(); first += static_cast<std::size_t>(options.step))
    clouds.push_back({.frame = drive.scans[first].frame,
                      .number = (frames_before + drive.scans[first].frame) / frames_per_number});
  executor.for_chunks(to_index(clouds.size()), 1, [&](Index begin, Index end) {
    for (Index i = begin; i < end; ++i) {
      const std::size_t first = static_cast<std::size_t>(i) * static_cast<std::size_t>(options.step);
      clouds[static_cast<std::size_t>(i)].place =
          std::make_shared<const PlaceDescriptor>(describe_place(accumulated(drive, first, options), place));
    }
  });
  return clouds;
}

}  // namespace chainslam::lamm
