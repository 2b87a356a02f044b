#pragma once

#include <cstddef>

#include "chainslam/cloud/point_cloud.hpp"

namespace chainslam {

namespace detail {

template <class T>
inline constexpr bool is_point_cloud = false;
template <class Scalar>
inline constexpr bool is_point_cloud<PointCloud<Scalar>> = true;

}  // namespace detail

/// Whether the cloud at hand carries a column: a `PointCloud` may leave it empty, other types have it by their traits.
template <Cloud Points>
[[nodiscard]] bool carries_normals(const Points& cloud) {
  if constexpr (detail::is_point_cloud<Points>) return cloud.has_normals();
  return OrientedCloud<Points> && cloud_size(cloud) > 0;
}

template <Cloud Points>
[[nodiscard]] bool carries_times(const Points& cloud) {
  if constexpr (detail::is_point_cloud<Points>) return cloud.has_times();
  return TimedCloud<Points> && cloud_size(cloud) > 0;
}

template <Cloud Points>
[[nodiscard]] bool carries_intensities([[maybe_unused]] const Points& cloud) {
  if constexpr (detail::is_point_cloud<Points>) return cloud.has_intensities();
  return false;
}

/// Normal i in double; call only if the cloud carries normals.
template <Cloud Points>
[[nodiscard]] Eigen::Vector3d normal(const Points& cloud, std::size_t i) {
  if constexpr (OrientedCloud<Points>) {
    const auto& n = CloudTraits<Points>::normal(cloud, i);
    return {static_cast<double>(n[0]), static_cast<double>(n[1]), static_cast<double>(n[2])};
  } else {
    return Eigen::Vector3d(0, 0, 0);
  }
}

/// Time offset i, seconds; call only if the cloud carries times.
template <Cloud Points>
[[nodiscard]] float time_offset(const Points& cloud, std::size_t i) {
  if constexpr (TimedCloud<Points>) {
    return static_cast<float>(CloudTraits<Points>::time_offset(cloud, i));
  } else {
    return 0;
  }
}

/// Intensity i; call only if the cloud carries intensities.
template <Cloud Points>
[[nodiscard]] float intensity(const Points& cloud, std::size_t i) {
  if constexpr (detail::is_point_cloud<Points>) {
    return cloud.intensities[i];
  } else {
    return 0;
  }
}

}  // namespace chainslam
