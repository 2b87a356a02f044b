#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <span>

#include "chainslam/cloud/detail/cell_block.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// Numbers voxels in the order in which they come and finds them by their cells: open addressing over 32-bit numbers,
/// at most half full. The cells of a brick share a line of memory, since points that follow one another mostly lie near
/// one another. Keys are compared whole, so different cells are never confused.
class VoxelTable {
 public:
  using Numbers = std::array<std::uint32_t, CellBlock::capacity>;  ///< a voxel for each point of a block

  /// Forgets all, but keeps its memory. Before all else.
  /// @param points  how many will come at the most.
  void start(std::size_t points) {
    size_ = 0;
    const std::size_t slots = std::bit_ceil(std::clamp(2 * points, std::size_t{64}, std::size_t{1} << 18));
    lines_.assign(static_cast<Offset>(slots / CellKeys::brick), Line{});
    keys_.reserve(static_cast<Offset>(std::min(points, slots / 2) + 1 + CellBlock::capacity));
    first_points_.reserve(keys_.capacity());
  }

  [[nodiscard]] std::size_t size() const { return size_; }
  [[nodiscard]] std::size_t capacity() const { return static_cast<std::size_t>(keys_.capacity()); }  ///< voxels
  [[nodiscard]] std::uint64_t key(std::size_t voxel) const { return keys_[static_cast<Offset>(voxel + 1)]; }
  /// The point with which each voxel came.
  [[nodiscard]] std::span<const Index> first_points() const { return {first_points_.data(), size_}; }

  /// The voxels of a block's points, in their order; new ones where there are none yet.
  void number(const CellBlock& block, Numbers& numbers) {
    while (2 * (size_ + block.size()) > slot_count()) grow();
    keys_.resize(static_cast<Offset>(size_ + 1 + block.size()));
    first_points_.resize(static_cast<Offset>(size_ + block.size()));
    const int shift = this->shift();
    for (std::size_t k = 0; k < block.size(); ++k) numbers[k] = home(block.hash(k), shift);
    for (std::size_t k = 0; k < block.size(); ++k) __builtin_prefetch(&slot(lines_.all(), numbers[k]));
    // Held here, for what is written below might be them.
    const std::span<Line> lines = lines_.all();
    std::uint64_t* const keys = keys_.data();
    Index* const first_points = first_points_.data();
    std::size_t size = size_;
    for (std::size_t k = 0; k < block.size(); ++k) {
      const std::uint64_t key = block.key(k);
      std::size_t i = numbers[k];
      std::uint32_t voxel = slot(lines, i);
      while (voxel != 0 && keys[voxel] != key) {
        i = next(lines, i);
        voxel = slot(lines, i);
      }
      if (voxel == 0) {
        first_points[size] = block.point(k);
        voxel = static_cast<std::uint32_t>(++size);
        keys[voxel] = key;
        slot(lines, i) = voxel;
      }
      numbers[k] = voxel - 1;
    }
    size_ = size;
  }

 private:
  struct alignas(32) Line {
    std::array<std::uint32_t, CellKeys::brick> slots{};
  };

  [[nodiscard]] std::size_t slot_count() const { return CellKeys::brick * lines_.all().size(); }
  [[nodiscard]] static std::uint32_t& slot(std::span<Line> lines, std::size_t i) {
    return lines[i / CellKeys::brick].slots[i % CellKeys::brick];
  }
  /// Another line and another place in it: near a taken slot most are taken. Odd, so that all slots come in turn.
  [[nodiscard]] static std::size_t next(std::span<Line> lines, std::size_t i) {
    return (i + CellKeys::brick + 1) & (CellKeys::brick * lines.size() - 1);
  }

  /// The shift that leaves the number of a line of a hash, at least 4 lines being there.
  [[nodiscard]] int shift() const { return 32 - std::countr_zero(lines_.all().size()); }
  [[nodiscard]] static std::uint32_t home(std::uint32_t hash, int shift) {
    return (hash >> shift) * std::uint32_t{CellKeys::brick} | hash % CellKeys::brick;
  }

  void grow() {
    lines_.assign(4 * lines_.size(), Line{});
    const std::span<Line> lines = lines_.all();
    for (std::size_t voxel = 1; voxel <= size_; ++voxel) {
      std::size_t i = home(CellKeys::hash(key(voxel - 1)), shift());
      while (slot(lines, i) != 0) i = next(lines, i);
      slot(lines, i) = static_cast<std::uint32_t>(voxel);
    }
  }

  Table<Line> lines_;          ///< numbers of voxels, counted from 1, or 0
  Table<std::uint64_t> keys_;  ///< of voxels counted from 1
  Table<Index> first_points_;
  std::size_t size_ = 0;
};

}  // namespace chainslam::detail
