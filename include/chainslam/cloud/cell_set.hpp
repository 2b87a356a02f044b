#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam {

/// A set of cells that only grows, for millions of them: one bit a cell in blocks of 8 x 8 x 8, which a `CellTable`
/// finds. Of cells along surfaces, most blocks have dozens, and a cell takes about 2 bytes instead of a table's 32.
class CellSet {
 public:
  /// Adds a cell. @returns whether it is new.
  bool insert(const Cell& cell) {
    const auto [block, fresh] = blocks_.insert({cell.x >> 3, cell.y >> 3, cell.z >> 3}, blocks_.size());
    if (fresh) bits_.push_back({});
    std::uint64_t& plane = bits_[block][static_cast<std::size_t>(cell.z & 7)];
    const std::uint64_t bit = std::uint64_t{1} << ((cell.x & 7) | (cell.y & 7) << 3);
    if ((plane & bit) != 0) return false;
    plane |= bit;
    ++size_;
    return true;
  }

  [[nodiscard]] Offset size() const { return size_; }  ///< number of cells
  /// Bytes held, roughly.
  [[nodiscard]] std::size_t memory() const { return blocks_.memory() + static_cast<std::size_t>(bits_.size()) * 64; }

 private:
  CellTable blocks_;  ///< to positions in `bits_`
  detail::Table<std::array<std::uint64_t, 8>> bits_;
  Offset size_ = 0;
};

}  // namespace chainslam
