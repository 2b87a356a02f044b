#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <span>
#include <stdexcept>
#include <vector>

#include "chainslam/cloud/columns.hpp"
#include "chainslam/cloud/detail/cell_block.hpp"
#include "chainslam/cloud/detail/voxel_table.hpp"
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
/// distance from the origin nor neighbouring clouds change which points share a voxel. Means are sums of whole numbers,
/// 2^-32 of the edge each, about the voxel's centre: the order of its points does not change a mean by a bit.
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

/// Puts the points into voxels, in their order. `first(block, i, point)` makes a voxel's content of point i of the
/// block, which is `point` of the cloud; `add(content, block, i, point)` adds another; `visit(point, voxel)` learns
/// where each went. Returns how many points were rejected.
template <class Content, Cloud Points, class First, class Add, class Visit>
Index fill_voxels(const Points& cloud, double inverse_size, VoxelTable<Content>& table, First&& first, Add&& add,
                  Visit&& visit) {
  const std::size_t count = static_cast<std::size_t>(to_index(cloud_size(cloud), "cloud"));
  Index rejected = 0;
  CellBlock block;
  for (std::size_t begin = 0; begin < count; begin += CellBlock::capacity) {
    const std::size_t size = std::min(CellBlock::capacity, count - begin);
    block.assign(cloud, begin, size, inverse_size);
    for (std::size_t i = 0; i < size; ++i) {
      if (!block.inside(i)) {
        ++rejected;
        continue;
      }
      const auto point = static_cast<Index>(begin + i);
      visit(begin + i, table.put(
                           block.cell(i), point, [&] { return first(block, i, point); },
                           [&](Content& content) { add(content, block, i, point); }));
    }
  }
  return rejected;
}

inline constexpr auto visit_nothing = [](std::size_t, std::size_t) {};

template <class Scalar, Cloud Points>
[[nodiscard]] DownsampledCloud<Scalar> first_in_voxels(const Points& cloud, double inverse_size) {
  struct Nothing {};
  VoxelTable<Nothing> table(cloud_size(cloud));
  const Index rejected = fill_voxels(
      cloud, inverse_size, table, [](const CellBlock&, std::size_t, Index) { return Nothing{}; },
      [](Nothing&, const CellBlock&, std::size_t, Index) {}, visit_nothing);
  return {.cloud = select<Scalar>(cloud, table.first_points()), .rejected = rejected};
}

/// The point of each voxel that is nearest its centre.
template <class Scalar, Cloud Points>
[[nodiscard]] DownsampledCloud<Scalar> nearest_in_voxels(const Points& cloud, double inverse_size) {
  struct Nearest {
    double squared_offset;
    Index point;
  };
  VoxelTable<Nearest> table(cloud_size(cloud));
  const auto first = [](const CellBlock& block, std::size_t i, Index point) {
    return Nearest{block.squared_offset(i), point};
  };
  const auto add = [](Nearest& nearest, const CellBlock& block, std::size_t i, Index point) {
    const double squared = block.squared_offset(i);
    const bool nearer = squared < nearest.squared_offset;
    nearest.point = nearer ? point : nearest.point;
    nearest.squared_offset = nearer ? squared : nearest.squared_offset;
  };
  const Index rejected = fill_voxels(cloud, inverse_size, table, first, add, visit_nothing);
  std::vector<Index> chosen;
  chosen.reserve(table.voxels().size());
  for (const auto& voxel : table.voxels()) chosen.push_back(voxel.content.point);
  return {.cloud = select<Scalar>(cloud, chosen), .rejected = rejected};
}

inline constexpr Index in_no_voxel = -1;

/// Sums of offsets, and how many: whole numbers, which any order of adding brings to the same bits.
struct VoxelSum {
  std::array<std::int64_t, 4> offsets;
  [[nodiscard]] double count() const { return static_cast<double>(offsets[3]); }

  explicit VoxelSum(const CellBlock::Offset& first) : offsets{first[0], first[1], first[2], first[3]} {}
  void add(const CellBlock::Offset& offset) {
    for (std::size_t i = 0; i < 4; ++i) offsets[i] += offset[i];
  }
};
using MeanTable = VoxelTable<VoxelSum>;

/// The mean of a voxel's points: of one point, that point.
template <Cloud Points>
[[nodiscard]] Eigen::Vector3d mean_position(const Points& cloud, const MeanTable::Voxel& voxel, Index first_point,
                                            double size) {
  const VoxelSum& sum = voxel.content;
  if (sum.offsets[3] == 1) return position(cloud, static_cast<std::size_t>(first_point));
  const double share = 1.0 / (CellBlock::offset_scale * sum.count());
  const auto coordinate = [&](std::int32_t cell, std::size_t axis) {
    return (cell + 0.5 + static_cast<double>(sum.offsets[axis]) * share) * size;
  };
  const Cell& cell = voxel.cell.cell;
  return {coordinate(cell.x, 0), coordinate(cell.y, 1), coordinate(cell.z, 2)};
}

/// Means of one column over the points of each voxel; `value(i)` is a number or a vector of doubles, like `zero`.
template <class T, class Value>
[[nodiscard]] std::vector<T> voxel_means(std::span<const Index> voxel_of_point, const MeanTable& table, const T& zero,
                                         Value&& value) {
  std::vector<T> means(table.voxels().size(), zero);
  for (std::size_t i = 0; i < voxel_of_point.size(); ++i)
    if (voxel_of_point[i] != in_no_voxel) means[static_cast<std::size_t>(voxel_of_point[i])] += value(i);
  for (std::size_t voxel = 0; voxel < means.size(); ++voxel) means[voxel] /= table.voxels()[voxel].content.count();
  return means;
}

/// Unit normals of the voxels: means made unit length again; of normals that cancel, the first point's.
template <class Scalar, Cloud Points>
[[nodiscard]] std::vector<Eigen::Matrix<Scalar, 3, 1>> mean_normals(const Points& cloud,
                                                                    std::span<const Index> voxel_of_point,
                                                                    const MeanTable& table) {
  constexpr double cancelled = 1e-3;
  const Eigen::Vector3d zero = Eigen::Vector3d::Zero();
  const auto means = voxel_means(voxel_of_point, table, zero, [&](std::size_t i) { return normal(cloud, i); });
  std::vector<Eigen::Matrix<Scalar, 3, 1>> normals;
  normals.reserve(means.size());
  for (std::size_t voxel = 0; voxel < means.size(); ++voxel) {
    const bool usable = means[voxel].norm() > cancelled;
    const Eigen::Vector3d mean =
        usable ? means[voxel] : normal(cloud, static_cast<std::size_t>(table.first_points()[voxel]));
    normals.push_back(mean.normalized().template cast<Scalar>());
  }
  return normals;
}

template <class Scalar, Cloud Points>
[[nodiscard]] DownsampledCloud<Scalar> mean_of_voxels(const Points& cloud, double size) {
  const bool normals = carries_normals(cloud), times = carries_times(cloud), intensities = carries_intensities(cloud);
  MeanTable table(cloud_size(cloud));
  std::vector<Index> voxel_of_point;
  const auto first = [](const CellBlock& block, std::size_t i, Index) { return VoxelSum(block.offset(i)); };
  const auto add = [](VoxelSum& sum, const CellBlock& block, std::size_t i, Index) { sum.add(block.offset(i)); };
  DownsampledCloud<Scalar> result;
  if (normals || times || intensities) {
    voxel_of_point.assign(cloud_size(cloud), in_no_voxel);
    const auto note = [&](std::size_t point, std::size_t voxel) { voxel_of_point[point] = static_cast<Index>(voxel); };
    result.rejected = fill_voxels(cloud, 1.0 / size, table, first, add, note);
  } else {
    result.rejected = fill_voxels(cloud, 1.0 / size, table, first, add, visit_nothing);
  }
  if (table.voxels().empty()) return result;
  PointCloud<Scalar>& means = result.cloud;
  means.positions.reserve(table.voxels().size());
  for (std::size_t voxel = 0; voxel < table.voxels().size(); ++voxel)
    means.positions.push_back(
        mean_position(cloud, table.voxels()[voxel], table.first_points()[voxel], size).template cast<Scalar>());
  const auto mean_column = [&](auto&& value) {
    const auto column = voxel_means(voxel_of_point, table, 0.0, value);
    return std::vector<float>(column.begin(), column.end());
  };
  if (normals) means.normals = mean_normals<Scalar>(cloud, voxel_of_point, table);
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
  if (mode == VoxelMode::mean) return detail::mean_of_voxels<Scalar>(cloud, size);
  if (mode == VoxelMode::first) return detail::first_in_voxels<Scalar>(cloud, 1.0 / size);
  return detail::nearest_in_voxels<Scalar>(cloud, 1.0 / size);
}

}  // namespace chainslam
