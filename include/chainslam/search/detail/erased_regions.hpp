#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <variant>
#include <vector>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/search/detail/regions.hpp"

namespace chainslam::detail {

/// The box of a cell, grown by what rounding may have moved its points.
template <int Dim>
[[nodiscard]] Eigen::AlignedBox<double, Dim> grown_cell_box(const Cell& cell, double cell_size) {
  constexpr double rounding = 8 * std::numeric_limits<double>::epsilon();
  const std::array<double, 3> corner{1.0 * cell.x, 1.0 * cell.y, 1.0 * cell.z};
  Eigen::AlignedBox<double, Dim> box;
  for (std::size_t axis = 0; axis < static_cast<std::size_t>(Dim); ++axis) {
    const double slack = rounding * (std::abs(corner[axis]) + 1);
    box.min()[static_cast<Eigen::Index>(axis)] = (corner[axis] - slack) * cell_size;
    box.max()[static_cast<Eigen::Index>(axis)] = (corner[axis] + 1 + slack) * cell_size;
  }
  return box;
}

/// Cells between two corners, and those around them.
class CellRange {
 public:
  template <int Dim>
  CellRange(const Eigen::AlignedBox<double, Dim>& box, double cell_size) {
    for (int axis = 0; axis < Dim; ++axis) {
      const auto i = static_cast<std::size_t>(axis);
      low_[i] = cell(box.min()[axis] / cell_size - 1);
      span_[i] =
          static_cast<std::uint32_t>(cell(box.max()[axis] / cell_size + 1)) - static_cast<std::uint32_t>(low_[i]);
    }
  }
  [[nodiscard]] bool contains(const Cell& at) const {
    const auto within = [&](std::int32_t coordinate, std::size_t axis) {
      return static_cast<std::uint32_t>(coordinate) - static_cast<std::uint32_t>(low_[axis]) <= span_[axis];
    };
    return (int{within(at.x, 0)} & int{within(at.y, 1)} & int{within(at.z, 2)}) != 0;
  }

 private:
  static std::int32_t cell(double coordinate) {
    constexpr double most = 2147483647;
    return static_cast<std::int32_t>(std::clamp(std::floor(coordinate), -most, most));
  }
  std::array<std::int32_t, 3> low_{};
  std::array<std::uint32_t, 3> span_{};
};

/// The regions that were lately erased from a map of voxels, in the order of their numbers: what a block of 4 x 4 x 4
/// voxels is to be asked about that has not been looked at since.
template <int Dim>
class ErasedRegions {
 public:
  using Box = Eigen::AlignedBox<double, Dim>;
  static constexpr std::size_t most = 8;

  explicit ErasedRegions(double voxel_size) : voxel_size_(voxel_size) {}

  [[nodiscard]] bool empty() const { return erased_.empty(); }
  [[nodiscard]] bool full() const { return erased_.size() == most; }
  /// The number of the last region.
  [[nodiscard]] std::uint64_t last() const { return last_; }
  [[nodiscard]] std::size_t memory() const { return erased_.capacity() * sizeof(Erased); }

  /// @param around  holds the points of which the map was not told
  template <class Region>
  void add(const Region& region, const Box& around) {
    erased_.push_back({region, CellRange(around, edge * voxel_size_), ++last_});
  }
  /// Lets go of the regions up to a number.
  void drop_until(std::uint64_t number) {
    std::erase_if(erased_, [&](const Erased& erased) { return erased.number <= number; });
  }

  /// Whether there may be something to say of a block.
  [[nodiscard]] bool concern(const Cell& block) const {
    return std::any_of(erased_.begin(), erased_.end(),
                       [&](const Erased& erased) { return erased.near.contains(block); });
  }
  /// Of the voxels that held points in a block, which knew of the regions up to number `seen`: those erased since.
  [[nodiscard]] std::uint64_t gone(const Cell& block, std::uint64_t held, std::uint64_t seen) const {
    std::uint64_t gone = 0;
    for (const Erased& erased : erased_)
      if (erased.number > seen && erased.near.contains(block))
        gone |= std::visit([&](const auto& region) { return inside(region, block, held & ~gone); }, erased.region);
    return gone;
  }

 private:
  static constexpr int edge = 4;
  using Boxed = BoxRegion<double, Dim>;
  using Ball = BallRegion<double, Dim>;
  struct Erased {
    std::variant<Boxed, Ball, Complement<Boxed>, Complement<Ball>> region;
    CellRange near;
    std::uint64_t number;
  };

  /// Those of a block's voxels that lie in a region as a whole.
  template <class Region>
  [[nodiscard]] std::uint64_t inside(const Region& region, const Cell& block, std::uint64_t voxels) const {
    const Overlap overlap = region.overlap(grown_cell_box<Dim>(block, edge * voxel_size_));
    if (overlap != Overlap::partly) return overlap == Overlap::inside ? voxels : 0;
    std::uint64_t inside = 0;
    for (; voxels != 0; voxels &= voxels - 1) {
      const int place = std::countr_zero(voxels);
      const Cell voxel{block.x * edge + place % edge, block.y * edge + place / edge % edge,
                       block.z * edge + place / (edge * edge)};
      if (region.overlap(grown_cell_box<Dim>(voxel, voxel_size_)) == Overlap::inside) inside |= voxels & (~voxels + 1);
    }
    return inside;
  }

  double voxel_size_;
  std::uint64_t last_ = 0;
  std::vector<Erased> erased_;
};

}  // namespace chainslam::detail
