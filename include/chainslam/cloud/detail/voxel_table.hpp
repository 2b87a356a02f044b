#pragma once

#include <algorithm>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "chainslam/cloud/detail/cell_block.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// Voxels in the order in which they came, found by their cells: open addressing with linear probing over 32-bit
/// numbers of voxels, at most half full. The eight cells of a cube of two edges share a line of memory, since points
/// that follow one another mostly lie near one another. Cells are compared whole, so different ones are never confused.
///
/// @tparam Content  what a voxel keeps of its points.
template <class Content>
class VoxelTable {
 public:
  struct Voxel {
    HashedCell cell;
    Content content;

    Voxel(const HashedCell& where, const Content& first) : cell(where), content(first) {}
  };

  /// @param points  how many will come at the most.
  explicit VoxelTable(std::size_t points)
      : slots_(std::bit_ceil(std::clamp(2 * points, std::size_t{64}, std::size_t{1} << 18))) {
    shift_ = 32 + 3 - std::countr_zero(slots_.size());
    voxels_.reserve(std::min(points, slots_.size() / 2));
    first_points_.reserve(voxels_.capacity());
  }

  [[nodiscard]] const std::vector<Voxel>& voxels() const { return voxels_; }
  /// The point with which each voxel came.
  [[nodiscard]] const std::vector<Index>& first_points() const { return first_points_; }

  /// Puts a point into the cell's voxel: `add(content)` where there is one, else one is made of `first()`. Returns its
  /// number.
  template <class First, class Add>
  std::size_t put(const HashedCell& cell, Index point, First&& first, Add&& add) {
    for (std::size_t i = home(cell);; i = (i + 1) & (slots_.size() - 1)) {
      const std::size_t voxel = slots_[i];
      if (voxel == 0) {
        voxels_.emplace_back(cell, first());
        first_points_.push_back(point);
        slots_[i] = static_cast<std::uint32_t>(voxels_.size());
        if (2 * voxels_.size() > slots_.size()) grow();
        return voxels_.size() - 1;
      }
      Voxel& there = voxels_[voxel - 1];
      if (!(there.cell == cell)) continue;
      add(there.content);
      return voxel - 1;
    }
  }

 private:
  [[nodiscard]] std::size_t home(const HashedCell& cell) const {
    return std::size_t{cell.hash >> shift_} << 3 | (cell.hash & 7U);
  }

  void grow() {
    slots_.assign(4 * slots_.size(), 0);
    shift_ -= 2;
    for (std::size_t voxel = 0; voxel < voxels_.size(); ++voxel) {
      std::size_t i = home(voxels_[voxel].cell);
      while (slots_[i] != 0) i = (i + 1) & (slots_.size() - 1);
      slots_[i] = static_cast<std::uint32_t>(voxel + 1);
    }
  }

  std::vector<std::uint32_t> slots_;  ///< the number of a voxel, counted from 1, or 0
  std::vector<Voxel> voxels_;
  std::vector<Index> first_points_;
  int shift_;
};

}  // namespace chainslam::detail
