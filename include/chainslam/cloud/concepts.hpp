#pragma once

#include <concepts>

#include "chainslam/cloud/traits.hpp"

namespace chainslam {

/// A sequence of 3-D points, metres, readable through `CloudTraits` in O(1) per point.
template <class T>
concept Cloud = requires(const T& cloud, std::size_t i) {
  { CloudTraits<T>::size(cloud) } -> std::convertible_to<std::size_t>;
  { CloudTraits<T>::position(cloud, i)[0] } -> std::convertible_to<double>;
  { CloudTraits<T>::position(cloud, i)[2] } -> std::convertible_to<double>;
};

/// A cloud with a unit normal at every point.
template <class T>
concept OrientedCloud = Cloud<T> && requires(const T& cloud, std::size_t i) {
  { CloudTraits<T>::normal(cloud, i)[0] } -> std::convertible_to<double>;
};

/// A cloud that knows when each point was measured, in seconds from the scan's stamp.
template <class T>
concept TimedCloud = Cloud<T> && requires(const T& cloud, std::size_t i) {
  { CloudTraits<T>::time_offset(cloud, i) } -> std::convertible_to<double>;
};

/// Number of points.
template <Cloud T>
[[nodiscard]] std::size_t cloud_size(const T& cloud) {
  return CloudTraits<T>::size(cloud);
}

/// Position i in double, whatever the cloud stores.
template <Cloud T>
[[nodiscard]] Eigen::Vector3d position(const T& cloud, std::size_t i) {
  const auto& p = CloudTraits<T>::position(cloud, i);
  return {static_cast<double>(p[0]), static_cast<double>(p[1]), static_cast<double>(p[2])};
}

/// Position i in float, the search structures' scalar.
template <Cloud T>
[[nodiscard]] Eigen::Vector3f position_f(const T& cloud, std::size_t i) {
  const auto& p = CloudTraits<T>::position(cloud, i);
  return {static_cast<float>(p[0]), static_cast<float>(p[1]), static_cast<float>(p[2])};
}

}  // namespace chainslam
