#pragma once

#include <Eigen/Geometry>
#include <concepts>
#include <vector>

#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/cloud/select.hpp"
#include "chainslam/core/finite.hpp"

namespace chainslam {

/// The points for which `keep(position)` holds (position: `Eigen::Vector3d`, metres), in their order, with all columns.
template <Cloud Points, std::predicate<const Eigen::Vector3d&> Keep>
[[nodiscard]] PointCloud<float> crop(const Points& cloud, Keep&& keep) {
  const Index count = to_index(cloud_size(cloud), "cloud");
  std::vector<Index> kept;
  for (Index i = 0; i < count; ++i)
    if (keep(position(cloud, static_cast<std::size_t>(i)))) kept.push_back(i);
  return select(cloud, kept);
}

/// The points whose distance from the origin lies in [min_range, max_range], metres; NaN and infinite points go.
template <Cloud Points>
[[nodiscard]] PointCloud<float> crop_range(const Points& cloud, double min_range, double max_range) {
  return crop(cloud, [=](const Eigen::Vector3d& p) {
    const double squared = p.squaredNorm();
    return is_finite(squared) && squared >= min_range * min_range && squared <= max_range * max_range;
  });
}

/// The points inside the closed box; NaN points go.
template <Cloud Points>
[[nodiscard]] PointCloud<float> crop_box(const Points& cloud, const Eigen::AlignedBox3d& box) {
  return crop(cloud, [&](const Eigen::Vector3d& p) { return is_finite(p) && box.contains(p); });
}

/// The points outside the closed box, such as the vehicle's own body; NaN and infinite points go.
template <Cloud Points>
[[nodiscard]] PointCloud<float> crop_outside_box(const Points& cloud, const Eigen::AlignedBox3d& box) {
  return crop(cloud, [&](const Eigen::Vector3d& p) { return is_finite(p) && !box.contains(p); });
}

}  // namespace chainslam
