#pragma once

#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/cloud/select.hpp"
#include "chainslam/core/finite.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam {

/// How many points were left out of scans, and why.
struct ScanFilterCounts {
  std::int64_t not_finite = 0;  ///< a coordinate or the time is NaN or infinite
  std::int64_t zero = 0;        ///< exactly (0, 0, 0): many drivers write that for no return
  std::int64_t near = 0;        ///< inside the blind radius
  std::int64_t far = 0;         ///< beyond the maximum range
  std::int64_t thinned = 0;     ///< usable, but not an n-th point
};

/// Drops what odometry should not see: broken returns, the vehicle's own body, far noise.
struct ScanFilter {
  double min_range = 1.0;    ///< metres from the sensor: the blind radius
  double max_range = 120.0;  ///< metres from the sensor
  Index every = 1;           ///< keep each n-th of the usable points

  /// @param sweep  n points, lidar frame.
  /// @returns the points kept, in their order, with times and intensities; what went is added to `counts`.
  /// @throws std::invalid_argument if a column's length is neither 0 nor n, or `every` < 1.
  [[nodiscard]] PointCloud<float> apply(const PointCloud<float>& sweep, ScanFilterCounts& counts) const {
    const auto fits = [&](const auto& column) { return column.empty() || column.size() == sweep.size(); };
    if (!fits(sweep.time_offsets) || !fits(sweep.intensities) || !fits(sweep.normals))
      throw std::invalid_argument("ScanFilter: a column of the scan is neither empty nor as long as its positions");
    if (every < 1) throw std::invalid_argument("ScanFilter: every must be at least 1");
    const bool timed = sweep.has_times();
    std::vector<Index> kept;
    kept.reserve(sweep.size());
    Index usable = 0;
    for (std::size_t i = 0; i < sweep.size(); ++i) {
      const Eigen::Vector3d p = converted<double>(sweep.positions[i]);
      const double squared_range = p.squaredNorm();
      if (!is_finite(squared_range) || (timed && !is_finite(sweep.time_offsets[i])))
        ++counts.not_finite;
      else if (squared_range == 0)
        ++counts.zero;
      else if (squared_range < min_range * min_range)
        ++counts.near;
      else if (squared_range > max_range * max_range)
        ++counts.far;
      else if (usable++ % every != 0)
        ++counts.thinned;
      else
        kept.push_back(static_cast<Index>(i));
    }
    return select(sweep, kept);
  }
};

}  // namespace chainslam
