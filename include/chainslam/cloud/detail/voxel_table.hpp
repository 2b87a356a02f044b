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
/// numbers of voxels, at most half full. Cells are compared whole, so different ones are never confused.
///
/// @tparam Content  what a voxel keeps of its points; a new one holds nothing.
template <class Content>
class VoxelTable {
 public:
  struct Voxel {
    HashedCell cell;
    Content content{};
  };

  /// @param points  how many will come at the most.
  explicit VoxelTable(std::size_t points)
      : slots_(std::bit_ceil(std::clamp(points / 2, std::size_t{64}, std::size_t{1} << 16))) {
    shift_ = 32 - std::countr_zero(slots_.size());
    voxels_.reserve(slots_.size() / 2);
    first_points_.reserve(slots_.size() / 2);
  }

  [[nodiscard]] const std::vector<Voxel>& voxels() const { return voxels_; }
  /// The point with which each voxel came.
  [[nodiscard]] const std::vector<Index>& first_points() const { return first_points_; }
  [[nodiscard]] Content& operator[](std::size_t voxel) { return voxels_[voxel].content; }

  /// The number of the cell's voxel, which comes with `point` if it is new.
  [[nodiscard]] std::size_t find_or_add(const HashedCell& cell, Index point) {
    for (std::size_t i = cell.hash >> shift_;; i = (i + 1) & (slots_.size() - 1)) {
      const std::size_t voxel = slots_[i];
      if (voxel == 0) return add(cell, point, i);
      if (voxels_[voxel - 1].cell == cell) return voxel - 1;
    }
  }

 private:
  std::size_t add(const HashedCell& cell, Index point, std::size_t slot) {
    voxels_.push_back({cell});
    first_points_.push_back(point);
    slots_[slot] = static_cast<std::uint32_t>(voxels_.size());
    if (2 * voxels_.size() > slots_.size()) grow();
    return voxels_.size() - 1;
  }

  void grow() {
    slots_.assign(4 * slots_.size(), 0);
    shift_ -= 2;
    for (std::size_t voxel = 0; voxel < voxels_.size(); ++voxel) {
      std::size_t i = voxels_[voxel].cell.hash >> shift_;
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
