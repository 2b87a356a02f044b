#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <stdexcept>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"
#include "chainslam/registration/detail/range_image.hpp"

namespace chainslam {

/// How far in front of what a sensor saw a point has to be for the sensor to have seen through it.
struct FreeSpaceOptions {
  double cell = 0.035;         ///< radians, of the range image: about what a downsampled cloud leaves no gaps in
  double margin = 1.0;         ///< metres in front of what was seen, and
  double margin_ratio = 0.05;  ///< metres for each metre of range
  double max_range = 60.0;     ///< metres: points farther off are not looked at
  Index max_points = 4096;     ///< that are looked at, evenly over the cloud
};

/// Points that a sensor had in view, and those of them that it saw something at or saw through. The others are hidden.
struct FreeSpaceCount {
  Index in_view = 0;       ///< points that the target's sensor would see
  Index confirmed = 0;     ///< where it saw something, to within the margin
  Index seen_through = 0;  ///< nearer to it

  /// Share of the points in view that were seen through; 0 if none was in view.
  [[nodiscard]] double share() const { return in_view > 0 ? static_cast<double>(seen_through) / in_view : 0.0; }
  /// Share of the points that are not hidden that were seen through; 0 if there are none.
  [[nodiscard]] double contradiction() const {
    const Index seen = confirmed + seen_through;
    return seen > 0 ? static_cast<double>(seen_through) / seen : 0.0;
  }

  /// Adds the counts of another part.
  FreeSpaceCount& operator+=(const FreeSpaceCount& other) {
    in_view += other.in_view;
    confirmed += other.confirmed;
    seen_through += other.seen_through;
    return *this;
  }
};

/// What a sensor saw from one place, and so what is free space: all that lies between it and what it saw (Bosse and
/// Zlot 2008). Points behind that are hidden and say nothing.
class FreeSpace {
 public:
  /// @param seen  points that the sensor saw from `viewpoint`, in one frame, metres.
  /// @throws std::invalid_argument if an option makes no sense.
  template <Cloud Points>
  [[gnu::cold]] FreeSpace(const Points& seen, const Eigen::Vector3d& viewpoint, const FreeSpaceOptions& options = {})
      : options_(checked(options)), image_(seen, viewpoint, options.cell) {}

  /// @param points        n points of another cloud, metres.
  /// @param T_seen_points from their frame to that of what was seen.
  template <Cloud Points>
  [[nodiscard]] [[gnu::cold]] FreeSpaceCount count(const Points& points, const SE3d& T_seen_points) const {
    FreeSpaceCount count;
    const Eigen::Matrix3d R = T_seen_points.rotation().matrix();
    const std::size_t size = cloud_size(points), most = static_cast<std::size_t>(options_.max_points);
    const std::size_t stride = std::max<std::size_t>(1, (size + most - 1) / most);
    for (std::size_t i = 0; i < size; i += stride) {
      const Eigen::Vector3d p = sum_of(product(R, position(points, i)), T_seen_points.translation());
      const double range = image_.range_of(p);
      if (!(range <= options_.max_range)) continue;
      const double seen = image_.free_range(p);
      if (seen == detail::RangeImage::unknown) continue;
      ++count.in_view;
      const double margin = options_.margin + options_.margin_ratio * seen;
      count.seen_through += range + margin < seen ? 1 : 0;
      count.confirmed += std::abs(range - seen) <= margin ? 1 : 0;
    }
    return count;
  }

 private:
  [[nodiscard]] static const FreeSpaceOptions& checked(const FreeSpaceOptions& options) {
    if (!(options.cell > 0) || !(options.margin >= 0) || options.max_points < 1)
      throw std::invalid_argument("FreeSpace: cell and max_points must be positive, margin not negative");
    return options;
  }

  FreeSpaceOptions options_;
  detail::RangeImage image_;
};

}  // namespace chainslam
