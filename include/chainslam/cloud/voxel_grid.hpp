#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <vector>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/cloud/detail/columns.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/finite.hpp"

namespace chainslam {

/// Which point stands for a voxel.
enum class VoxelMode {
  mean,               ///< the mean of all columns; normals are made unit length again
  first,              ///< the first point that fell into it, untouched
  nearest_to_center,  ///< the point nearest the voxel's centre, the first of equals, untouched
};

/// What a voxel grid made of a cloud.
template <class Scalar = float>
struct DownsampledCloud {
  PointCloud<Scalar> cloud;  ///< one point a voxel, voxels in the order in which their first point came
  Index rejected = 0;        ///< points left out: NaN, infinite, or 2^31 or more voxels from the origin
};

/// Keeps one point in each cubic voxel.
///
/// Voxel (0, 0, 0) has its lower corner at the origin. Cells are whole numbers computed in double, so that neither
/// distance from the origin nor neighbouring clouds change which points share a voxel. The result depends on the order
/// of the points alone.
struct VoxelGrid {
  double size = 0.5;  ///< edge, metres
  VoxelMode mode = VoxelMode::mean;

  /// @param cloud  n points in any frame; its normals, times and intensities are carried along.
  /// @throws std::invalid_argument if `size` is not positive and finite.
  template <class Scalar = float, Cloud Points>
  [[nodiscard]] DownsampledCloud<Scalar> downsample(const Points& cloud) const;
};

/// The cloud of `VoxelGrid{voxel_size, mode}.downsample(cloud)`.
template <Cloud Points>
[[nodiscard]] PointCloud<float> voxel_downsample(const Points& cloud, double voxel_size,
                                                 VoxelMode mode = VoxelMode::mean) {
  return VoxelGrid{.size = voxel_size, .mode = mode}.downsample<float>(cloud).cloud;
}

namespace detail {

/// Which voxel every point fell into, voxels numbered as they first appear.
struct VoxelGroups {
  std::vector<Index> voxel_of_point;  ///< -1: rejected
  std::vector<Index> first_point;     ///< of each voxel
  Index rejected = 0;
};

template <Cloud Points>
[[nodiscard]] VoxelGroups group_by_voxel(const Points& cloud, double inverse_size) {
  const Index count = to_index(cloud_size(cloud), "cloud");
  VoxelGroups groups;
  groups.voxel_of_point.resize(static_cast<std::size_t>(count), -1);
  CellTable table;
  Cell last_cell;
  Index last_voxel = -1;  // neighbours in a scan often share a voxel
  for (Index i = 0; i < count; ++i) {
    const Eigen::Vector3d scaled = position(cloud, static_cast<std::size_t>(i)) * inverse_size;
    const std::optional<Cell> cell = cell_of(scaled);
    if (!cell) {
      ++groups.rejected;
      continue;
    }
    if (last_voxel < 0 || !(*cell == last_cell)) {
      const std::pair<Index, bool> found = table.insert(*cell, table.size());
      if (found.second) groups.first_point.push_back(i);
      last_cell = *cell;
      last_voxel = found.first;
    }
    groups.voxel_of_point[static_cast<std::size_t>(i)] = last_voxel;
  }
  return groups;
}

template <Cloud Points>
[[nodiscard]] std::vector<Index> nearest_to_centers(const Points& cloud, const VoxelGroups& groups,
                                                    double inverse_size) {
  std::vector<Index> nearest = groups.first_point;
  std::vector<double> best(nearest.size(), std::numeric_limits<double>::max());
  for (std::size_t i = 0; i < groups.voxel_of_point.size(); ++i) {
    if (groups.voxel_of_point[i] < 0) continue;
    const auto voxel = static_cast<std::size_t>(groups.voxel_of_point[i]);
    const Eigen::Vector3d scaled = position(cloud, i) * inverse_size;
    const double distance = (scaled.array() - scaled.array().floor() - 0.5).matrix().squaredNorm();
    if (distance < best[voxel]) {
      best[voxel] = distance;
      nearest[voxel] = static_cast<Index>(i);
    }
  }
  return nearest;
}

/// Means of one column over the points of each voxel, summed in double in the order of the points.
template <int Rows, class Value>
[[nodiscard]] std::vector<Eigen::Matrix<double, Rows, 1>> voxel_means(const VoxelGroups& groups, Value&& value) {
  using Vector = Eigen::Matrix<double, Rows, 1>;
  std::vector<Vector> sums(groups.first_point.size(), Vector::Zero());
  std::vector<Index> counts(groups.first_point.size(), 0);
  for (std::size_t i = 0; i < groups.voxel_of_point.size(); ++i) {
    if (groups.voxel_of_point[i] < 0) continue;
    const auto voxel = static_cast<std::size_t>(groups.voxel_of_point[i]);
    sums[voxel] += value(i);
    ++counts[voxel];
  }
  for (std::size_t voxel = 0; voxel < sums.size(); ++voxel) sums[voxel] /= static_cast<double>(counts[voxel]);
  return sums;
}

template <class Scalar, Cloud Points>
[[nodiscard]] PointCloud<Scalar> mean_of_voxels(const Points& cloud, const VoxelGroups& groups) {
  PointCloud<Scalar> means;
  const auto fill = [](auto& column, const auto& values, auto&& convert) {
    column.reserve(values.size());
    for (const auto& value : values) column.push_back(convert(value));
  };
  const auto to_vector = [](const Eigen::Vector3d& v) { return v.cast<Scalar>().eval(); };
  const auto to_float = [](const Eigen::Matrix<double, 1, 1>& v) { return static_cast<float>(v[0]); };
  fill(means.positions, voxel_means<3>(groups, [&](std::size_t i) { return position(cloud, i); }), to_vector);
  if (carries_normals(cloud)) {
    auto normals = voxel_means<3>(groups, [&](std::size_t i) { return normal(cloud, i); });
    for (std::size_t voxel = 0; voxel < normals.size(); ++voxel) {
      // Opposite normals cancel: then the first point's is the honest one.
      if (!(normals[voxel].norm() > 1e-3))
        normals[voxel] = normal(cloud, static_cast<std::size_t>(groups.first_point[voxel]));
      normals[voxel].normalize();
    }
    fill(means.normals, normals, to_vector);
  }
  const auto scalar = [](double value) { return Eigen::Matrix<double, 1, 1>(value); };
  if (carries_times(cloud))
    fill(means.time_offsets, voxel_means<1>(groups, [&](std::size_t i) { return scalar(time_offset(cloud, i)); }),
         to_float);
  if (carries_intensities(cloud))
    fill(means.intensities, voxel_means<1>(groups, [&](std::size_t i) { return scalar(intensity(cloud, i)); }),
         to_float);
  return means;
}

}  // namespace detail

template <class Scalar, Cloud Points>
DownsampledCloud<Scalar> VoxelGrid::downsample(const Points& cloud) const {
  if (!(size > 0) || !is_finite(1.0 / size) || !is_finite(size))
    throw std::invalid_argument("VoxelGrid: size must be positive and finite");
  const double inverse_size = 1.0 / size;
  const detail::VoxelGroups groups = detail::group_by_voxel(cloud, inverse_size);
  DownsampledCloud<Scalar> result{.cloud = {}, .rejected = groups.rejected};
  switch (mode) {
    case VoxelMode::mean:
      result.cloud = detail::mean_of_voxels<Scalar>(cloud, groups);
      break;
    case VoxelMode::first:
      result.cloud = detail::select<Scalar>(cloud, groups.first_point);
      break;
    case VoxelMode::nearest_to_center:
      result.cloud = detail::select<Scalar>(cloud, detail::nearest_to_centers(cloud, groups, inverse_size));
      break;
  }
  return result;
}

}  // namespace chainslam
