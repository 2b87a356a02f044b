#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <span>
#include <vector>

#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/lie/se3.hpp"

namespace chainslam {

/// Points in columns: `positions` always, the others either empty or as long as `positions`.
///
/// Coordinates are metres near a local origin (a sensor's or a session's frame): float keeps 1 mm up to 8 km from it.
template <class Scalar = float>
struct PointCloud {
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;  ///< a position or a normal

  std::vector<Vector3> positions{};   ///< metres
  std::vector<Vector3> normals{};     ///< unit length
  std::vector<float> time_offsets{};  ///< seconds from the scan's stamp
  std::vector<float> intensities{};   ///< the sensor's own scale

  [[nodiscard]] std::size_t size() const { return positions.size(); }  ///< number of points
  [[nodiscard]] bool empty() const { return positions.empty(); }       ///< whether there is nothing in it
  /// Whether there is a normal for each point.
  [[nodiscard]] bool has_normals() const { return !positions.empty() && normals.size() == positions.size(); }
  /// Whether there is a time offset for each point.
  [[nodiscard]] bool has_times() const { return !positions.empty() && time_offsets.size() == positions.size(); }
  /// Whether there is an intensity for each point.
  [[nodiscard]] bool has_intensities() const { return !positions.empty() && intensities.size() == positions.size(); }
};

/// A `PointCloud` is a cloud of its positions, with normals and times where it has them.
template <class Scalar>
struct CloudTraits<PointCloud<Scalar>> {
  using Points = PointCloud<Scalar>;                                               ///< the cloud
  static std::size_t size(const Points& cloud) { return cloud.positions.size(); }  ///< number of points
  /// Position of point i, metres.
  static const auto& position(const Points& cloud, std::size_t i) { return cloud.positions[i]; }
  /// Unit normal of point i, where there are normals.
  static const auto& normal(const Points& cloud, std::size_t i) { return cloud.normals[i]; }
  /// Seconds of point i from the scan's stamp, where there are times.
  static float time_offset(const Points& cloud, std::size_t i) { return cloud.time_offsets[i]; }
};
static_assert(Cloud<PointCloud<float>> && OrientedCloud<PointCloud<float>> && TimedCloud<PointCloud<double>>);
static_assert(Cloud<std::vector<Eigen::Vector3f>> && !OrientedCloud<std::vector<Eigen::Vector3f>>);

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

/// The points at `indices`, in that order, with every column the cloud carries; an index may come more than once.
///
/// @param indices  each from 0 to the cloud's size - 1.
template <class Scalar = float, Cloud Points>
[[nodiscard]] PointCloud<Scalar> select(const Points& cloud, std::span<const Index> indices) {
  PointCloud<Scalar> chosen;
  const auto fill = [&](auto& column, auto&& value) {
    column.reserve(indices.size());
    for (const Index i : indices) column.push_back(value(static_cast<std::size_t>(i)));
  };
  fill(chosen.positions, [&](std::size_t i) { return converted<Scalar>(position(cloud, i)); });
  if (carries_normals(cloud)) fill(chosen.normals, [&](std::size_t i) { return converted<Scalar>(normal(cloud, i)); });
  if (carries_times(cloud)) fill(chosen.time_offsets, [&](std::size_t i) { return time_offset(cloud, i); });
  if (carries_intensities(cloud)) fill(chosen.intensities, [&](std::size_t i) { return intensity(cloud, i); });
  return chosen;
}

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
