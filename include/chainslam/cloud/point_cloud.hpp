#pragma once

#include <Eigen/Core>
#include <vector>

#include "chainslam/cloud/concepts.hpp"

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

}  // namespace chainslam
