#pragma once

#include "chainslam/cloud/columns.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// The cloud seen from frame a: p_a = T_a_b * p_b, computed in double; normals are rotated, other columns copied.
///
/// NaN points stay NaN. Coordinates of the result should be near a's origin: float keeps 1 mm up to 8 km.
template <Cloud Points>
[[nodiscard]] PointCloud<float> transformed(const Points& cloud, const SE3d& T_a_b) {
  const Eigen::Matrix3d R_a_b = T_a_b.rotation().matrix();
  const Eigen::Vector3d& p_a_b = T_a_b.translation();
  const std::size_t count = cloud_size(cloud);
  PointCloud<float> result;
  const auto rounded = [](const Eigen::Vector3d& p) {
    return Eigen::Vector3f(static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2]));
  };
  const auto fill = [&](auto& column, auto&& value) {
    column.resize(count);
    for (std::size_t i = 0; i < count; ++i) column[i] = value(i);
  };
  fill(result.positions, [&](std::size_t i) { return rounded(sum_of(product(R_a_b, position(cloud, i)), p_a_b)); });
  if constexpr (OrientedCloud<Points>)
    if (carries_normals(cloud))
      fill(result.normals, [&](std::size_t i) { return rounded(product(R_a_b, normal(cloud, i))); });
  if (carries_times(cloud)) fill(result.time_offsets, [&](std::size_t i) { return time_offset(cloud, i); });
  if (carries_intensities(cloud)) fill(result.intensities, [&](std::size_t i) { return intensity(cloud, i); });
  return result;
}

}  // namespace chainslam
