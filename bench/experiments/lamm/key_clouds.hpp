#pragma once

#include <cstddef>
#include <memory>
#include <utility>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/executor.hpp"
#include "chainslam/core/types.hpp"
#include "drive.hpp"
#include "place_descriptor.hpp"

namespace chainslam::lamm {

/// Which scans are put together to a key cloud. LAMM takes ten scans in a row, which a keyframe set does not have: ten
/// keyframes take their place, of which so many as lie within some length.
struct KeyCloudOptions {
  double voxel_size = 0.25;  ///< metres, of each scan before it is put with the others
  Index max_scans = 10;      ///< of a key cloud
  double max_length = 30.0;  ///< metres along the path, from the first scan of a key cloud to its last
  double spacing = 9.0;      ///< metres along the path, at least, from the start of one key cloud to that of the next
};

/// Some scans in a row, described in the body frame of the first.
struct KeyCloud {
  Index frame = 0;  ///< of the drive, of its first scan
  Index number =
      0;  ///< what LAMM counts it as: frames since the start of the first drive, over the frames of a key cloud
  std::shared_ptr<const PlaceDescriptor> place{};
};

namespace detail {

/// Metres along the path of odometry to each scan.
[[nodiscard]] inline std::vector<double> ways_to_scans(const Drive& drive) {
  std::vector<double> ways;
  Index frame = 0;
  double way = 0;
  for (const Scan& scan : drive.scans) {
    for (; frame < scan.frame; ++frame)
      way += (drive.pose(frame + 1).translation() - drive.pose(frame).translation()).norm();
    ways.push_back(way);
  }
  return ways;
}

/// A key cloud's scans: the first, and the one after the last.
struct ScanRange {
  std::size_t first = 0, end = 0;
};

[[nodiscard]] inline std::vector<ScanRange> scan_ranges(const Drive& drive, const KeyCloudOptions& options) {
  const std::vector<double> ways = ways_to_scans(drive);
  std::vector<ScanRange> ranges;
  for (std::size_t i = 0; i < ways.size(); ++i) {
    if (!ranges.empty() && ways[i] - ways[ranges.back().first] < options.spacing) continue;
    std::size_t end = i + 1;
    while (end < ways.size() && end < i + static_cast<std::size_t>(options.max_scans) &&
           ways[end] - ways[i] <= options.max_length)
      ++end;
    ranges.push_back({i, end});
  }
  return ranges;
}

/// Scans of a drive, in the body frame of the first.
[[nodiscard]] inline PointCloud<float> accumulated(const Drive& drive, const ScanRange& range, double voxel_size) {
  const SE3d T_first_odom = drive.pose(drive.scans[range.first].frame).inverse();
  PointCloud<float> cloud;
  for (std::size_t i = range.first; i < range.end; ++i) {
    const Scan& scan = drive.scans[i];
    const PointCloud<float> thinned = voxel_downsample(*scan.cloud, voxel_size);
    const PointCloud<float> moved = transformed(thinned.positions, T_first_odom * drive.pose(scan.frame));
    cloud.positions.insert(cloud.positions.end(), moved.positions.begin(), moved.positions.end());
  }
  return cloud;
}

}  // namespace detail

/// The described key clouds of a drive.
/// @param frames_before  of the drives before this one.
/// @param frames_per_number  frames in a row that LAMM makes a key cloud of.
template <Executor Exec>
[[nodiscard]] std::vector<KeyCloud> key_clouds(const Drive& drive, const KeyCloudOptions& options,
                                               const PlaceDescriptorOptions& place, Index frames_before,
                                               Index frames_per_number, const Exec& executor) {
  const std::vector<detail::ScanRange> ranges = detail::scan_ranges(drive, options);
  std::vector<KeyCloud> clouds;
  for (const detail::ScanRange& range : ranges) {
    const Index frame = drive.scans[range.first].frame;
    clouds.push_back({.frame = frame, .number = (frames_before + frame) / frames_per_number});
  }
  executor.for_chunks(to_index(clouds.size()), 1, [&](Index begin, Index end) {
    for (auto i = static_cast<std::size_t>(begin); i < static_cast<std::size_t>(end); ++i)
      clouds[i].place = std::make_shared<const PlaceDescriptor>(
          describe_place(detail::accumulated(drive, ranges[i], options.voxel_size), place));
  });
  return clouds;
}

}  // namespace chainslam::lamm
