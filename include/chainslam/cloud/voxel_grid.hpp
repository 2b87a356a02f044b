#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <limits>
#include <span>
#include <stdexcept>
#include <type_traits>
#include <utility>
#include <vector>

#include "chainslam/cloud/detail/cell_block.hpp"
#include "chainslam/cloud/detail/voxel_table.hpp"
#include "chainslam/cloud/point_cloud.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"

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
/// 2^-31 of the edge each, about the voxel's centre: the order of its points does not change a mean by a bit.
struct VoxelGrid {
  double size = 0.5;                 ///< edge, metres
  VoxelMode mode = VoxelMode::mean;  ///< what a voxel's points become

  /// @param cloud  n points in any frame; its normals, times and intensities are carried along.
  /// @throws std::invalid_argument if `size` is not positive and finite.
  template <class Scalar = float, Cloud Points>
  [[nodiscard]] DownsampledCloud<Scalar> downsample(const Points& cloud) const;
};

namespace detail {

inline void require_voxel_size(double size) {
  if (!(size > 0) || !is_finite(1.0 / size) || !is_finite(size))
    throw std::invalid_argument("VoxelGrid: size must be positive and finite");
}

/// Sums of offsets, and how many: whole numbers, whose sums are bit-identical in any order.
struct alignas(32) VoxelSum {
  std::array<std::int64_t, 4> offsets{};

  [[nodiscard]] double count() const { return static_cast<double>(offsets[3]); }
  void add(const CellBlock::Offset& offset) {
    for (std::size_t i = 0; i < 4; ++i) offsets[i] += offset.numbers[i];
  }
};

/// Voxels with the sums of their points.
struct MeanTable {
  VoxelTable voxels{};
  CellKeys keys{};
  Table<VoxelSum> sums{};
};

/// The table that a thread keeps from one cloud to the next, since fresh memory would cost as much as the work; for one
/// cloud at a time, and freed where it has become large.
class LentTable {
 public:
  explicit LentTable(std::size_t points) : table_(std::exchange(kept(), {})) {
    table_.voxels.start(points);
    table_.keys = {};
    table_.sums.clear();
  }
  ~LentTable() {
    constexpr std::size_t largest = std::size_t{1} << 18;  // voxels; with their sums 11 MB
    if (table_.voxels.capacity() <= largest) kept() = std::move(table_);
  }
  LentTable(const LentTable&) = delete;
  LentTable& operator=(const LentTable&) = delete;

  [[nodiscard]] MeanTable& operator*() { return table_; }

 private:
  [[nodiscard]] static MeanTable& kept() {
    thread_local MeanTable table;
    return table;
  }

  MeanTable table_;
};

/// Puts the points into voxels, in their order. `visit(block, voxels)` learns where those of each block went, by which
/// time the table has them. Returns how many points were rejected.
template <Cloud Points, class Visit>
Index fill_voxels(const Points& cloud, double inverse_size, MeanTable& table, Visit&& visit) {
  const std::size_t count = static_cast<std::size_t>(to_index(cloud_size(cloud), "cloud"));
  std::size_t kept = 0;
  CellBlock block;
  VoxelTable::Numbers voxels;
  for (std::size_t begin = 0; begin < count; begin += CellBlock::capacity) {
    block.assign(cloud, begin, std::min(CellBlock::capacity, count - begin), inverse_size, table.keys);
    table.voxels.number(block, voxels);
    visit(block, voxels);
    kept += block.size();
  }
  return static_cast<Index>(count - kept);
}

template <class Scalar, Cloud Points>
[[nodiscard]] DownsampledCloud<Scalar> first_in_voxels(const Points& cloud, double inverse_size) {
  LentTable lent(cloud_size(cloud));
  const Index rejected = fill_voxels(cloud, inverse_size, *lent, [](const CellBlock&, const VoxelTable::Numbers&) {});
  return {.cloud = select<Scalar>(cloud, (*lent).voxels.first_points()), .rejected = rejected};
}

/// The point of each voxel that is nearest its centre.
template <class Scalar, Cloud Points>
[[nodiscard]] DownsampledCloud<Scalar> nearest_in_voxels(const Points& cloud, double inverse_size) {
  LentTable lent(cloud_size(cloud));
  MeanTable& table = *lent;
  std::vector<double> least;  // squared offsets
  std::vector<Index> chosen;
  const auto compare = [&](const CellBlock& block, const VoxelTable::Numbers& voxels) {
    least.resize(table.voxels.size(), std::numeric_limits<double>::max());
    chosen.resize(table.voxels.size());
    for (std::size_t i = 0; i < block.size(); ++i) {
      const double squared = block.squared_offset(i);
      if (squared < least[voxels[i]]) {
        least[voxels[i]] = squared;
        chosen[voxels[i]] = block.point(i);
      }
    }
  };
  const Index rejected = fill_voxels(cloud, inverse_size, table, compare);
  return {.cloud = select<Scalar>(cloud, chosen), .rejected = rejected};
}

inline constexpr Index in_no_voxel = -1;

/// The means of the voxels' points: of one point, that point.
template <class Scalar, Cloud Points>
void mean_positions(const Points& cloud, const MeanTable& table, double size,
                    std::vector<Eigen::Matrix<Scalar, 3, 1>>& means) {
  using Doubles4 = double __attribute__((vector_size(32)));
  using Floats4 = float __attribute__((vector_size(16)));
  using Longs4 = std::int64_t __attribute__((vector_size(32)));
  using Scalars = std::conditional_t<sizeof(Scalar) == sizeof(float), Floats4, Doubles4>;
  means.resize(table.sums.all().size());
  for (std::size_t voxel = 0; voxel < means.size(); ++voxel) {
    Longs4 sum;
    std::memcpy(&sum, table.sums.data() + voxel, sizeof sum);
    const double share = 1.0 / (CellBlock::offset_scale * static_cast<double>(sum[3]));
    Doubles4 corner;
    table.keys.cell(table.voxels.key(voxel), corner);
    const Doubles4 mean = (corner + 0.5 + __builtin_convertvector(sum, Doubles4) * share) * size;
    // Chosen without a branch, which would be a guess.
    const Eigen::Vector3d p = position(cloud, static_cast<std::size_t>(table.voxels.first_points()[voxel]));
    const Doubles4 point{p[0], p[1], p[2], 0};
    const Longs4 alone = Longs4{} - (sum[3] == 1 ? 1 : 0);
    const Doubles4 chosen = alone ? point : mean;
    const Scalars rounded = __builtin_convertvector(chosen, Scalars);
    means[voxel] = {rounded[0], rounded[1], rounded[2]};
  }
}

/// Means of one column over the points of each voxel; `value(i)` is a number or a vector of doubles, like `zero`.
template <class T, class Value>
[[nodiscard]] std::vector<T> voxel_means(std::span<const Index> voxel_of_point, const MeanTable& table, const T& zero,
                                         Value&& value) {
  std::vector<T> means(table.sums.all().size(), zero);
  for (std::size_t i = 0; i < voxel_of_point.size(); ++i)
    if (voxel_of_point[i] != in_no_voxel) means[static_cast<std::size_t>(voxel_of_point[i])] += value(i);
  for (std::size_t voxel = 0; voxel < means.size(); ++voxel) means[voxel] /= table.sums.all()[voxel].count();
  return means;
}

/// Unit normals of the voxels: means made unit length again; of normals that cancel, the first point's.
template <class Scalar, Cloud Points>
[[nodiscard]] std::vector<Eigen::Matrix<Scalar, 3, 1>> mean_normals(const Points& cloud,
                                                                    std::span<const Index> voxel_of_point,
                                                                    const MeanTable& table) {
  constexpr double cancelled = 1e-3;
  const auto zero = zeros<Eigen::Vector3d>();
  const auto means = voxel_means(voxel_of_point, table, zero, [&](std::size_t i) { return normal(cloud, i); });
  std::vector<Eigen::Matrix<Scalar, 3, 1>> normals;
  normals.reserve(means.size());
  for (std::size_t voxel = 0; voxel < means.size(); ++voxel) {
    const bool usable = means[voxel].norm() > cancelled;
    const Eigen::Vector3d mean =
        usable ? means[voxel] : normal(cloud, static_cast<std::size_t>(table.voxels.first_points()[voxel]));
    const double length = mean.norm();
    normals.push_back(converted<Scalar>(length > 0 ? divided(mean, length) : mean));
  }
  return normals;
}

template <class Scalar, Cloud Points>
[[nodiscard]] DownsampledCloud<Scalar> mean_of_voxels(const Points& cloud, double size) {
  const bool normals = carries_normals(cloud), times = carries_times(cloud), intensities = carries_intensities(cloud);
  LentTable lent(cloud_size(cloud));
  MeanTable& table = *lent;
  table.sums.reserve(static_cast<Offset>(std::min<std::size_t>(cloud_size(cloud), 1 << 17)));
  std::vector<Index> voxel_of_point;
  if (normals || times || intensities) voxel_of_point.assign(cloud_size(cloud), in_no_voxel);
  const auto add = [&](const CellBlock& block, const VoxelTable::Numbers& voxels) {
    table.sums.resize(static_cast<Offset>(table.voxels.size()));
    // Points that follow one another often share a voxel, whose sum would be waited for: four far ones at a time.
    constexpr std::size_t stride = CellBlock::capacity / 4;
    for (std::size_t first = 0; first < stride; ++first)
      for (std::size_t i = first; i < block.size(); i += stride) table.sums[voxels[i]].add(block.offset(i));
    if (voxel_of_point.empty()) return;
    for (std::size_t i = 0; i < block.size(); ++i)
      voxel_of_point[static_cast<std::size_t>(block.point(i))] = static_cast<Index>(voxels[i]);
  };
  DownsampledCloud<Scalar> result;
  result.rejected = fill_voxels(cloud, 1.0 / size, table, add);
  PointCloud<Scalar>& means = result.cloud;
  mean_positions(cloud, table, size, means.positions);
  const auto mean_column = [&](auto&& value) {
    const std::vector<double> column = voxel_means(voxel_of_point, table, 0.0, value);
    std::vector<float> rounded(column.size());
    for (std::size_t voxel = 0; voxel < column.size(); ++voxel) rounded[voxel] = static_cast<float>(column[voxel]);
    return rounded;
  };
  if constexpr (OrientedCloud<Points>)
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
  detail::require_voxel_size(size);
  if (mode == VoxelMode::mean) return detail::mean_of_voxels<Scalar>(cloud, size);
  if (mode == VoxelMode::first) return detail::first_in_voxels<Scalar>(cloud, 1.0 / size);
  return detail::nearest_in_voxels<Scalar>(cloud, 1.0 / size);
}

/// The cloud of `VoxelGrid{voxel_size}.downsample(cloud)`, ...
template <Cloud Points>
[[nodiscard]] PointCloud<float> voxel_downsample(const Points& cloud, double voxel_size) {
  detail::require_voxel_size(voxel_size);  // no more than means: the other modes need not be compiled
  return detail::mean_of_voxels<float>(cloud, voxel_size).cloud;
}
/// ... and of `VoxelGrid{voxel_size, mode}.downsample(cloud)`.
template <Cloud Points>
[[nodiscard]] PointCloud<float> voxel_downsample(const Points& cloud, double voxel_size, VoxelMode mode) {
  return VoxelGrid{.size = voxel_size, .mode = mode}.downsample<float>(cloud).cloud;
}

}  // namespace chainslam
