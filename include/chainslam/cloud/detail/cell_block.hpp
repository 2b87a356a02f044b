#pragma once

#include <Eigen/Core>
#include <array>
#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// Cells as numbers of 64 bits, different ones for different cells: 21 bits an axis about one of them, and for what
/// lies farther from it a number out of a table.
class CellKeys {
 public:
  static constexpr int bits = 21;
  static constexpr std::uint32_t span = std::uint32_t{1} << bits;
  static constexpr std::size_t brick = 8;                       ///< cells of a brick, two by two by two
  using Coordinates = double __attribute__((vector_size(32)));  ///< x, y, z and 0

  /// The cell in the middle of those that need no table. Once, before all else.
  void center(const Cell& cell) {
    low_ = {number(cell.x) - span / 2, number(cell.y) - span / 2, number(cell.z) - span / 2};
  }

  [[nodiscard]] static std::uint64_t near_key(std::uint32_t x, std::uint32_t y, std::uint32_t z) {
    return x | std::uint64_t{y} << bits | std::uint64_t{z} << 2 * bits;
  }

  [[nodiscard]] std::uint64_t key(const Cell& cell) {
    const std::uint32_t x = number(cell.x) - low_[0], y = number(cell.y) - low_[1], z = number(cell.z) - low_[2];
    if ((x | y | z) < span) return near_key(x, y, z);
    const auto [index, fresh] = far_.insert(cell, static_cast<Index>(far_cells_.size()));
    if (fresh) far_cells_.push_back(cell);
    return far_bit | static_cast<std::uint64_t>(index);
  }

  /// The cell of a key.
  void cell(std::uint64_t key, Coordinates& to) const {
    if ((key & far_bit) != 0) {
      const Cell& far = far_cells_[static_cast<std::int64_t>(key & ~far_bit)];
      to = Coordinates{static_cast<double>(far.x), static_cast<double>(far.y), static_cast<double>(far.z), 0};
      return;
    }
    using Parts = std::uint64_t __attribute__((vector_size(32)));
    using Numbers = std::uint32_t __attribute__((vector_size(16)));
    using SignedNumbers = std::int32_t __attribute__((vector_size(16)));
    const Parts parts = (Parts{key, key, key, 0} >> Parts{0, bits, 2 * bits, 0}) & (span - 1);
    const Numbers wrapped = __builtin_convertvector(parts, Numbers) + Numbers{low_[0], low_[1], low_[2], 0};
    SignedNumbers numbers;
    std::memcpy(&numbers, &wrapped, sizeof numbers);
    to = __builtin_convertvector(numbers, Coordinates);
  }

  /// Of the brick that holds a cell, and in its three lowest bits which of the brick's cells it is.
  [[nodiscard]] static std::uint32_t hash(std::uint32_t x, std::uint32_t y, std::uint32_t z) {
    const std::uint32_t mixed = (x >> 1) * 0x9e37'79b1U + (y >> 1) * 0x85eb'ca77U + (z >> 1) * 0xc2b2'ae3dU;
    const std::uint32_t place = (x & 1U) | (y & 1U) << 1 | (z & 1U) << 2;
    return (mixed & ~7U) | place;
  }
  [[nodiscard]] static std::uint32_t hash(std::uint64_t key) { return hash(part(key, 0), part(key, 1), part(key, 2)); }

 private:
  static constexpr std::uint64_t far_bit = std::uint64_t{1} << 63;

  [[nodiscard]] static std::uint32_t number(std::int32_t coordinate) { return static_cast<std::uint32_t>(coordinate); }
  [[nodiscard]] static std::uint32_t part(std::uint64_t key, int axis) {
    return static_cast<std::uint32_t>(key >> axis * bits) & (span - 1);
  }

  std::array<std::uint32_t, 3> low_{};
  CellTable far_;
  Table<Cell> far_cells_;
};

/// The cells of a few hundred points at a time, those left out that have none: several coordinates at once, x, y and z
/// of each point behind one another.
class CellBlock {
 public:
  static constexpr std::size_t capacity = 128;
  static constexpr int offset_bits = 31;
  static constexpr double offset_scale = 2147483648.0;  ///< 2^31: offsets an edge

  /// Where a point lies in its cell: from the centre, in 2^-31 of the edge, rounded down; and a one.
  /// These are whole numbers, so that their sums depend on neither the order of the points nor the number of threads.
  struct alignas(16) Offset {
    std::array<std::int32_t, 4> numbers;
  };

  /// Takes points [begin, begin + count), count <= capacity; a cell is floor(p * inverse_size), in double. A point has
  /// one if it is finite and less than 2^31 cells from the origin.
  template <Cloud Points>
  void assign(const Points& cloud, std::size_t begin, std::size_t count, double inverse_size, CellKeys& keys) {
    for (std::size_t i = 0; i < count; ++i) {
      const Eigen::Vector3d p = position(cloud, begin + i);
      for (std::size_t axis = 0; axis < 3; ++axis)
        scaled_[3 * i + axis] = p[static_cast<Eigen::Index>(axis)] * inverse_size;
    }
    for (std::size_t i = 0; i < count; ++i) points_[i] = static_cast<Index>(begin + i);
    size_ = count;
    if (begin == 0) center(keys);
    if (split()) {
      pack();
    } else {
      pack_one_by_one(keys);
    }
    gather_offsets();
  }

  /// How many points have a cell.
  [[nodiscard]] std::size_t size() const { return size_; }
  [[nodiscard]] Index point(std::size_t i) const { return points_[i]; }
  [[nodiscard]] std::uint64_t key(std::size_t i) const { return keys_[i]; }
  [[nodiscard]] std::uint32_t hash(std::size_t i) const { return hashes_[i]; }
  [[nodiscard]] const Offset& offset(std::size_t i) const { return point_offsets_[i]; }
  [[nodiscard]] double squared_offset(std::size_t i) const {
    const double x = offsets_[3 * i], y = offsets_[3 * i + 1], z = offsets_[3 * i + 2];
    return x * x + y * y + z * z;
  }

 private:
#if defined(__AVX512F__)
  static constexpr std::size_t lanes = 8;
#elif defined(__AVX__)
  static constexpr std::size_t lanes = 4;
#else
  static constexpr std::size_t lanes = 2;
#endif
  using Doubles = double __attribute__((vector_size(8 * lanes)));
  using Longs = std::uint64_t __attribute__((vector_size(8 * lanes)));
  using Ints = std::uint32_t __attribute__((vector_size(4 * lanes)));
  using Row = std::int32_t __attribute__((vector_size(16)));
  template <class T>
  using Column = std::array<T, capacity>;
  template <class T>
  using Interleaved = std::array<T, 3 * capacity>;

  // The mantissa of 1.5 * 2^21 + v, v within 2^20 of zero, holds (v + 2^20) * 2^31 in its 52 bits: 21 of the cell, 31
  // of the offset. Nothing has to be converted between doubles and integers.
  static constexpr double base = 2097152.0;  // 2^21
  static constexpr std::uint64_t base_bits = std::bit_cast<std::uint64_t>(base);
  static constexpr std::uint64_t mantissa = (std::uint64_t{1} << 52) - 1;
  static constexpr std::uint64_t offset_mask = (std::uint64_t{1} << offset_bits) - 1;
  static constexpr std::uint32_t half_edge = std::uint32_t{1} << (offset_bits - 1);
  static_assert(CellKeys::bits + offset_bits == 52);

  // Bits are compared, which is right for NaN under -ffast-math, too.
  static constexpr std::uint64_t magnitude = ~std::uint64_t{0} >> 1;
  static constexpr auto limit = std::bit_cast<std::uint64_t>(2147483647.0);
  /// Numbers as large as this keep all their bits when a whole number within 2^20 of them is taken off.
  static constexpr auto coarse = std::bit_cast<std::uint64_t>(524288.0);  // 2^19

  [[nodiscard]] static bool inside(double scaled) { return (std::bit_cast<std::uint64_t>(scaled) & magnitude) < limit; }

  /// Cells are numbered about the origin, or along an axis on which the first point is far from it, about that point's.
  void center(CellKeys& keys) {
    std::array<std::int32_t, 3> middle{};
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const double first = scaled_[axis];
      const bool far = inside(first) && (std::bit_cast<std::uint64_t>(first) & magnitude) >= coarse;
      if (far) middle[axis] = static_cast<std::int32_t>(first);
      for (std::size_t i = axis; i < 3 * lanes; i += 3) {
        centers_[i] = middle[axis];
        coarse_[i] = far ? coarse : 0;
      }
    }
    keys.center({middle[0], middle[1], middle[2]});
  }

  /// Cells, counted from the lowest near one, and offsets. Returns whether these are right, which they are if all
  /// points are near.
  [[nodiscard]] bool split() {
    const std::size_t size = 3 * ((size_ + lanes - 1) / lanes * lanes);
    for (std::size_t i = 3 * size_; i < size; ++i) scaled_[i] = centers_[i % 3];
    Longs wrong{};
    for (std::size_t i = 0; i < size; i += 3 * lanes)
      for (std::size_t k = 0; k < 3 * lanes; k += lanes) wrong |= split(i + k, k);
    std::uint64_t any = 0;
    for (std::size_t lane = 0; lane < lanes; ++lane) any |= wrong[lane];
    return (any & ~mantissa) == 0;
  }

  /// The same of as many coordinates as there are lanes. Returns numbers with bits above the mantissa's for wrong ones.
  [[nodiscard]] Longs split(std::size_t i, std::size_t center) {
    Doubles v, middle;
    Longs least;
    std::memcpy(&v, &scaled_[i], sizeof v);
    std::memcpy(&middle, &centers_[center], sizeof middle);
    std::memcpy(&least, &coarse_[center], sizeof least);
    const Longs too_fine = ((std::bit_cast<Longs>(v) & magnitude) - least) & ~magnitude;
    v -= middle;
    const Longs sum = std::bit_cast<Longs>(v + 1.5 * base);
    const Longs not_near = sum ^ base_bits;
    // The sum is rounded to the nearest: where that is upwards, one less.
    Longs fixed = sum & mantissa;
    fixed += std::bit_cast<Longs>(std::bit_cast<Doubles>(fixed | base_bits) - 1.5 * base > v);
    const Ints cell = __builtin_convertvector(fixed >> offset_bits, Ints);
    const Ints offset = __builtin_convertvector(fixed & offset_mask, Ints) - half_edge;
    std::memcpy(&cells_[i], &cell, sizeof cell);
    std::memcpy(&offsets_[i], &offset, sizeof offset);
    return too_fine | not_near | fixed;
  }

  void pack() {
    const std::size_t size = size_;
    for (std::size_t i = 0; i < size; ++i) {
      const std::uint32_t x = cells_[3 * i], y = cells_[3 * i + 1], z = cells_[3 * i + 2];
      hashes_[i] = CellKeys::hash(x, y, z);
      keys_[i] = CellKeys::near_key(x, y, z);
    }
  }

  /// The same of any points; those that have no cell are left out.
  void pack_one_by_one(CellKeys& keys) {
    std::size_t kept = 0;
    for (std::size_t i = 0; i < size_; ++i) {
      if (!inside(scaled_[3 * i]) || !inside(scaled_[3 * i + 1]) || !inside(scaled_[3 * i + 2])) continue;
      std::array<std::int32_t, 3> cell;
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const double v = scaled_[3 * i + axis], floor = std::floor(v);
        // Just below a whole number, v - floor is rounded, upwards where the sum is the larger one.
        const double below = std::floor((v - floor) * offset_scale);
        const bool up = floor + below / offset_scale > v;
        cell[axis] = static_cast<std::int32_t>(floor);
        offsets_[3 * kept + axis] = static_cast<std::int32_t>(below - (up ? 1 : 0) - half_edge);
      }
      keys_[kept] = keys.key({cell[0], cell[1], cell[2]});
      hashes_[kept] = CellKeys::hash(keys_[kept]);
      points_[kept++] = points_[i];
    }
    size_ = kept;
  }

  void gather_offsets() {
    const std::size_t size = size_;
    for (std::size_t i = 0; i < size; ++i) {
      Row row;
      std::memcpy(&row, &offsets_[3 * i], sizeof row);
      row[3] = 1;
      std::memcpy(&point_offsets_[i], &row, sizeof row);
    }
  }

  alignas(64) Interleaved<double> scaled_;
  alignas(64) Interleaved<std::uint32_t> cells_;
  alignas(64) std::array<std::int32_t, 3 * capacity + 1> offsets_;  // one more, since they are read by four
  alignas(64) std::array<double, 3 * lanes> centers_;
  alignas(64) std::array<std::uint64_t, 3 * lanes> coarse_;  // what a number must be at least to be right
  alignas(64) Column<std::uint64_t> keys_;
  alignas(64) Column<std::uint32_t> hashes_;
  alignas(64) Column<Offset> point_offsets_;
  alignas(64) Column<Index> points_;
  std::size_t size_ = 0;
};

}  // namespace chainslam::detail
