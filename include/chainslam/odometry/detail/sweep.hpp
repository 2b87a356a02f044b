#pragma once

#include <algorithm>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/timestamp.hpp"

namespace chainslam::detail {

/// The usable points of a scan, LiDAR frame.
struct Sweep {
  Timestamp begin, end;
  PointCloud<float> points;

  /// Seconds from the points' mean time to the sweep's end.
  [[nodiscard]] double mean_age() const {
    if (!points.has_times()) return 0;
    double sum = 0;
    for (const float offset : points.time_offsets) sum += static_cast<double>(offset);
    const double duration = to_seconds(end - begin);
    return std::clamp(duration - sum / static_cast<double>(points.size()), 0.0, duration);
  }
};

}  // namespace chainslam::detail
