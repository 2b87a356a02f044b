#pragma once

#include <Eigen/Core>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <utility>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam {

/// A cell of a cubic grid whose cell (0, 0, 0) has its lower corner at the origin.
struct Cell {
  std::int32_t x = 0;  ///< index along x
  std::int32_t y = 0;  ///< index along y
  std::int32_t z = 0;  ///< index along z

  friend constexpr bool operator==(const Cell&, const Cell&) = default;  ///< whether all members are equal
};

namespace detail {

/// floor(value), or nothing if value is NaN, infinite or does not fit 32 bits. Compares bits: right under -ffast-math.
[[nodiscard]] inline bool cell_coordinate(double value, std::int32_t& cell) {
  constexpr std::uint64_t magnitude = 0x7fff'ffff'ffff'ffffU;
  constexpr auto limit = std::bit_cast<std::uint64_t>(2147483647.0);
  if ((std::bit_cast<std::uint64_t>(value) & magnitude) >= limit) return false;
  const auto truncated = static_cast<std::int32_t>(value);
  cell = truncated - (value < truncated ? 1 : 0);
  return true;
}

}  // namespace detail

/// The cell that holds a point; `scaled` is the point divided by the cell's size, in double, so that the answer is
/// exact 500 km from the origin. Nothing if a coordinate is NaN, infinite, or 2^31 or more cells away.
[[nodiscard]] inline std::optional<Cell> cell_of(const Eigen::Vector3d& scaled) {
  Cell cell;
  if (detail::cell_coordinate(scaled[0], cell.x) && detail::cell_coordinate(scaled[1], cell.y) &&
      detail::cell_coordinate(scaled[2], cell.z))
    return cell;
  return std::nullopt;
}

/// A hash table from cells to indices: open addressing with linear probing, 16 bytes a slot, at most half full.
///
/// Cells are compared whole, so different cells are never confused, however far from the origin. The table has no order
/// of its own: callers number the cells, which keeps results independent of the hash.
class CellTable {
 public:
  CellTable() : slots_(min_slots) {}

  [[nodiscard]] Index size() const { return size_; }  ///< number of cells
  /// Bytes held.
  [[nodiscard]] std::size_t memory() const { return static_cast<std::size_t>(slots_.capacity()) * sizeof(Slot); }

  /// The index stored for `cell`, or -1.
  [[nodiscard]] Index find(const Cell& cell) const {
    for (Offset i = home(cell);; i = next(i)) {
      const Slot& slot = slots_[i];
      if (slot.index < 0 || slot.cell == cell) return slot.index;
    }
  }

  /// The index stored for `cell`; a new cell gets `index` (>= 0). The second member is true if it was new.
  std::pair<Index, bool> insert(const Cell& cell, Index index) {
    for (Offset i = home(cell);; i = next(i)) {
      Slot& slot = slots_[i];
      if (slot.index >= 0 && !(slot.cell == cell)) continue;
      if (slot.index >= 0) return {slot.index, false};
      slot = {cell, index};
      ++size_;
      if (Offset{2} * size_ > slots_.size()) grow();
      return {index, true};
    }
  }

  /// Replaces the index of a cell that is in the table.
  void assign(const Cell& cell, Index index) {
    Offset i = home(cell);
    while (!(slots_[i].index >= 0 && slots_[i].cell == cell)) i = next(i);
    slots_[i].index = index;
  }

  /// Removes a cell; does nothing if it is not there. Later cells of the probe sequence move back: no tombstones.
  void erase(const Cell& cell) {
    Offset hole = home(cell);
    for (;; hole = next(hole)) {
      if (slots_[hole].index < 0) return;
      if (slots_[hole].cell == cell) break;
    }
    for (Offset i = next(hole); slots_[i].index >= 0; i = next(i)) {
      const Offset wanted = home(slots_[i].cell);
      if (((i - wanted) & mask()) >= ((i - hole) & mask())) {
        slots_[hole] = slots_[i];
        hole = i;
      }
    }
    slots_[hole].index = -1;
    --size_;
  }

  /// Erases everything.
  void clear() {
    slots_.assign(min_slots, Slot{});
    shift_ = min_shift;
    size_ = 0;
  }

 private:
  struct Slot {
    Cell cell;
    Index index = -1;
  };
  static constexpr Offset min_slots = 64;
  static constexpr int min_shift = 64 - 6;

  [[nodiscard]] Offset mask() const { return slots_.size() - 1; }
  [[nodiscard]] Offset next(Offset i) const { return (i + 1) & mask(); }

  /// Three odd multipliers mix the axes; the top bits of one more product are the slot (Knuth's multiplicative
  /// hashing).
  [[nodiscard]] Offset home(const Cell& cell) const {
    std::uint64_t h = static_cast<std::uint32_t>(cell.x) * 0x9e37'79b9'7f4a'7c15U +
                      static_cast<std::uint32_t>(cell.y) * 0xc2b2'ae3d'27d4'eb4fU +
                      static_cast<std::uint32_t>(cell.z) * 0x1656'67b1'9e37'79f9U;
    h ^= h >> 32;
    return static_cast<Offset>((h * 0x9fb2'1c65'1e98'df25U) >> shift_);
  }

  void grow() {
    const detail::Table<Slot> old = std::exchange(slots_, detail::Table<Slot>(2 * slots_.size()));
    --shift_;
    for (const Slot& slot : old) {
      if (slot.index < 0) continue;
      Offset i = home(slot.cell);
      while (slots_[i].index >= 0) i = next(i);
      slots_[i] = slot;
    }
  }

  detail::Table<Slot> slots_;
  int shift_ = min_shift;
  Index size_ = 0;
};

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
