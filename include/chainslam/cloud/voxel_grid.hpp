#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>
#include <stdexcept>
#include <vector>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/cloud/detail/columns.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/cloud/select.hpp"
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

/// Calls `visit(i, voxel, p, offset)` for the points in their order; `voxel` counts the voxels as they first appear,
/// `offset` is where p lies in its voxel, from the centre, in voxel sizes. Returns how many points were rejected.
template <Cloud Points, class Visit>
Index visit_voxels(const Points& cloud, double inverse_size, Visit&& visit) {
  const Index count = to_index(cloud_size(cloud), "cloud");
  CellTable table;
  Cell last_cell;
  Index last_voxel = -1;  // neighbours in a scan often share a voxel
  Index rejected = 0;
  for (Index i = 0; i < count; ++i) {
    const Eigen::Vector3d p = position(cloud, static_cast<std::size_t>(i));
    const Eigen::Vector3d scaled = p * inverse_size;
    const std::optional<Cell> cell = cell_of(scaled);
    if (!cell) {
      ++rejected;
      continue;
    }
    if (last_voxel < 0 || !(*cell == last_cell)) {
      last_cell = *cell;
      last_voxel = table.insert(*cell, table.size()).first;
    }
    visit(static_cast<std::size_t>(i), static_cast<std::size_t>(last_voxel), p,
          Eigen::Vector3d(scaled - Eigen::Vector3d(cell->x + 0.5, cell->y + 0.5, cell->z + 0.5)));
  }
  return rejected;
}

/// The first point of each voxel, or the one nearest its centre.
template <class Scalar, Cloud Points>
[[nodiscard]] DownsampledCloud<Scalar> choose_in_voxels(const Points& cloud, double inverse_size, bool nearest) {
  std::vector<Index> chosen;
  std::vector<double> squared_offsets;
  const Index rejected =
      visit_voxels(cloud, inverse_size,
                   [&](std::size_t i, std::size_t voxel, const Eigen::Vector3d&, const Eigen::Vector3d& offset) {
                     const double squared = nearest ? offset.squaredNorm() : 0.0;
                     if (voxel == chosen.size()) {
                       chosen.push_back(static_cast<Index>(i));
                       squared_offsets.push_back(squared);
                     } else if (squared < squared_offsets[voxel]) {
                       chosen[voxel] = static_cast<Index>(i);
                       squared_offsets[voxel] = squared;
                     }
                   });
  return {.cloud = select<Scalar>(cloud, chosen), .rejected = rejected};
}

/// A voxel's sum of positions, in double in the order of the points.
struct VoxelSum {
  Eigen::Vector3d position = Eigen::Vector3d::Zero();
  Index count = 0;
  Index first_point = 0;
};

inline constexpr Index in_no_voxel = -1;

/// Means of one column over the points of each voxel; `value(i)` is a number or a vector of doubles, like `zero`.
template <class T, class Value>
[[nodiscard]] std::vector<T> voxel_means(std::span<const Index> voxel_of_point, const std::vector<VoxelSum>& voxels,
                                         const T& zero, Value&& value) {
  std::vector<T> means(voxels.size(), zero);
  for (std::size_t i = 0; i < voxel_of_point.size(); ++i)
    if (voxel_of_point[i] != in_no_voxel) means[static_cast<std::size_t>(voxel_of_point[i])] += value(i);
  for (std::size_t voxel = 0; voxel < voxels.size(); ++voxel) means[voxel] /= static_cast<double>(voxels[voxel].count);
  return means;
}

/// Unit normals of the voxels: means made unit length again; of normals that cancel, the first point's.
template <class Scalar, Cloud Points>
[[nodiscard]] std::vector<Eigen::Matrix<Scalar, 3, 1>> mean_normals(const Points& cloud,
                                                                    std::span<const Index> voxel_of_point,
                                                                    const std::vector<VoxelSum>& voxels) {
  constexpr double cancelled = 1e-3;
  const Eigen::Vector3d zero = Eigen::Vector3d::Zero();
  const auto means = voxel_means(voxel_of_point, voxels, zero, [&](std::size_t i) { return normal(cloud, i); });
  std::vector<Eigen::Matrix<Scalar, 3, 1>> normals;
  normals.reserve(voxels.size());
  for (std::size_t voxel = 0; voxel < voxels.size(); ++voxel) {
    const bool usable = means[voxel].norm() > cancelled;
    const Eigen::Vector3d mean =
        usable ? means[voxel] : normal(cloud, static_cast<std::size_t>(voxels[voxel].first_point));
    normals.push_back(mean.normalized().template cast<Scalar>());
  }
  return normals;
}

template <class Scalar, Cloud Points>
[[nodiscard]] DownsampledCloud<Scalar> mean_of_voxels(const Points& cloud, double inverse_size) {
  const bool normals = carries_normals(cloud), times = carries_times(cloud), intensities = carries_intensities(cloud);
  std::vector<VoxelSum> voxels;
  std::vector<Index> voxel_of_point(normals || times || intensities ? cloud_size(cloud) : 0, in_no_voxel);
  DownsampledCloud<Scalar> result;
  result.rejected = visit_voxels(
      cloud, inverse_size, [&](std::size_t i, std::size_t voxel, const Eigen::Vector3d& p, const Eigen::Vector3d&) {
        if (voxel == voxels.size()) voxels.emplace_back().first_point = static_cast<Index>(i);
        voxels[voxel].position += p;
        ++voxels[voxel].count;
        if (!voxel_of_point.empty()) voxel_of_point[i] = static_cast<Index>(voxel);
      });
  if (voxels.empty()) return result;
  PointCloud<Scalar>& means = result.cloud;
  means.positions.reserve(voxels.size());
  for (const VoxelSum& sum : voxels)
    means.positions.push_back((sum.position / static_cast<double>(sum.count)).template cast<Scalar>());
  const auto mean_column = [&](auto&& value) {
    const auto column = voxel_means(voxel_of_point, voxels, 0.0, value);
    return std::vector<float>(column.begin(), column.end());
  };
  if (normals) means.normals = mean_normals<Scalar>(cloud, voxel_of_point, voxels);
  if (times)
    means.time_offsets = mean_column([&](std::size_t i) { return static_cast<double>(time_offset(cloud, i)); });
  if (intensities)
    means.intensities = mean_column([&](std::size_t i) { return static_cast<double>(intensity(cloud, i)); });
  return result;
}

}  // namespace detail

template <class Scalar, Cloud Points>
DownsampledCloud<Scalar> VoxelGrid::downsample(const Points& cloud) const {
  if (!(size > 0) || !is_finite(1.0 / size) || !is_finite(size))
    throw std::invalid_argument("VoxelGrid: size must be positive and finite");
  if (mode == VoxelMode::mean) return detail::mean_of_voxels<Scalar>(cloud, 1.0 / size);
  return detail::choose_in_voxels<Scalar>(cloud, 1.0 / size, mode == VoxelMode::nearest_to_center);
}

}  // namespace chainslam
