#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/cloud/concepts.hpp"
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

  /// The lowest coordinates that need no table.
  [[nodiscard]] const std::array<std::uint32_t, 3>& lowest() const { return low_; }
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
      const Cell& far = far_cells_[key & ~far_bit];
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
  std::vector<Cell> far_cells_;
};

/// The cells of a few hundred points at a time, those left out that have none: reckoned in columns, several at once.
class CellBlock {
 public:
  static constexpr std::size_t capacity = 128;
  static constexpr double offset_scale = 4294967296.0;  ///< 2^32: offsets an edge

  /// Where a point lies in its cell: from the centre, in 2^-32 of the edge, rounded towards the centre; and a one.
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
      for (std::size_t axis = 0; axis < 3; ++axis) scaled_[axis][i] = p[static_cast<Eigen::Index>(axis)] * inverse_size;
    }
    for (std::size_t i = 0; i < count; ++i) points_[i] = static_cast<Index>(begin + i);
    size_ = count;
    bool all_inside = true;
    for (std::size_t axis = 0; axis < 3; ++axis) all_inside &= split(axis);
    if (begin == 0) keys.center(cell(0));
    const bool all_near = pack(keys);
    if (!all_inside || !all_near) pack_one_by_one(keys);
    gather_offsets();
  }

  /// How many points have a cell.
  [[nodiscard]] std::size_t size() const { return size_; }
  [[nodiscard]] Index point(std::size_t i) const { return points_[i]; }
  [[nodiscard]] std::uint64_t key(std::size_t i) const { return keys_[i]; }
  [[nodiscard]] std::uint32_t hash(std::size_t i) const { return hashes_[i]; }
  [[nodiscard]] const Offset& offset(std::size_t i) const { return point_offsets_[i]; }
  [[nodiscard]] double squared_offset(std::size_t i) const {
    const double x = offsets_[0][i], y = offsets_[1][i], z = offsets_[2][i];
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
  using Longs = std::int64_t __attribute__((vector_size(8 * lanes)));
  using Ints = std::int32_t __attribute__((vector_size(4 * lanes)));
  using Row = std::int32_t __attribute__((vector_size(16)));
  template <class T>
  using Column = std::array<T, capacity>;
  // Bits are compared, which is right for NaN under -ffast-math, too.
  static constexpr auto magnitude = std::int64_t{0x7fff'ffff'ffff'ffff};
  static constexpr auto limit = std::bit_cast<std::int64_t>(2147483647.0);

  [[nodiscard]] Cell cell(std::size_t i) const { return {cells_[0][i], cells_[1][i], cells_[2][i]}; }
  [[nodiscard]] bool inside(std::size_t i) const {
    return std::all_of(scaled_.begin(), scaled_.end(), [&](const Column<double>& column) {
      return (std::bit_cast<std::int64_t>(column[i]) & magnitude) < limit;
    });
  }

  /// Cells and offsets along one axis. Returns whether all points have one.
  [[nodiscard]] bool split(std::size_t axis) {
    constexpr double largest_offset = 2147483647.0;
    Column<double>& scaled = scaled_[axis];
    for (std::size_t i = size_; i % lanes != 0; ++i) scaled[i] = 0;
    Longs all_inside = Longs{} - 1;
    const std::size_t size = size_;
    for (std::size_t i = 0; i < size; i += lanes) {
      Longs value;
      std::memcpy(&value, &scaled[i], sizeof value);
      const Longs is_inside = (value & magnitude) < limit;
      all_inside &= is_inside;
      value &= is_inside;
      Doubles v;
      std::memcpy(&v, &value, sizeof v);
      const Ints truncated = __builtin_convertvector(v, Ints);
      const Doubles whole = __builtin_convertvector(truncated, Doubles);
      const Doubles floor = v < whole ? whole - 1.0 : whole;
      const Ints cell = __builtin_convertvector(floor, Ints);
      std::memcpy(&cells_[axis][i], &cell, sizeof cell);
      // Just below a whole number, v - floor rounds to 1.
      Doubles offset = (v - floor - 0.5) * offset_scale;
      offset = offset < largest_offset ? offset : largest_offset - Doubles{};
      const Ints rounded = __builtin_convertvector(offset, Ints);
      std::memcpy(&offsets_[axis][i], &rounded, sizeof rounded);
    }
    std::int64_t all = -1;
    for (std::size_t lane = 0; lane < lanes; ++lane) all &= all_inside[lane];
    return all != 0;
  }

  /// Keys and hashes. Returns whether all points are so near one another that these are right.
  [[nodiscard]] bool pack(const CellKeys& keys) {
    std::uint32_t any = 0;
    const std::array<std::uint32_t, 3> lowest = keys.lowest();  // a copy, which nothing written here can be
    const std::size_t size = size_;
    for (std::size_t i = 0; i < size; ++i) {
      const std::uint32_t x = static_cast<std::uint32_t>(cells_[0][i]) - lowest[0];
      const std::uint32_t y = static_cast<std::uint32_t>(cells_[1][i]) - lowest[1];
      const std::uint32_t z = static_cast<std::uint32_t>(cells_[2][i]) - lowest[2];
      any |= x | y | z;
      hashes_[i] = CellKeys::hash(x, y, z);
      above_[0][i] = x, above_[1][i] = y, above_[2][i] = z;
    }
    for (std::size_t i = 0; i < size; ++i) keys_[i] = CellKeys::near_key(above_[0][i], above_[1][i], above_[2][i]);
    return any < CellKeys::span;
  }

  /// Leaves out the points that have no cell.
  void pack_one_by_one(CellKeys& keys) {
    std::size_t kept = 0;
    for (std::size_t i = 0; i < size_; ++i) {
      if (!inside(i)) continue;
      keys_[kept] = keys.key(cell(i));
      hashes_[kept] = CellKeys::hash(keys_[kept]);
      for (auto& column : offsets_) column[kept] = column[i];
      points_[kept++] = points_[i];
    }
    size_ = kept;
  }

  void gather_offsets() {
    const Row one = Row{} + 1;
    const std::size_t size = size_;
    for (std::size_t i = 0; i < size; i += 4) {
      Row x, y, z;
      std::memcpy(&x, &offsets_[0][i], sizeof x);
      std::memcpy(&y, &offsets_[1][i], sizeof y);
      std::memcpy(&z, &offsets_[2][i], sizeof z);
      const Row xy_low = __builtin_shufflevector(x, y, 0, 4, 1, 5), xy_high = __builtin_shufflevector(x, y, 2, 6, 3, 7);
      const Row z1_low = __builtin_shufflevector(z, one, 0, 4, 1, 5);
      const Row z1_high = __builtin_shufflevector(z, one, 2, 6, 3, 7);
      put_row(__builtin_shufflevector(xy_low, z1_low, 0, 1, 4, 5), i);
      put_row(__builtin_shufflevector(xy_low, z1_low, 2, 3, 6, 7), i + 1);
      put_row(__builtin_shufflevector(xy_high, z1_high, 0, 1, 4, 5), i + 2);
      put_row(__builtin_shufflevector(xy_high, z1_high, 2, 3, 6, 7), i + 3);
    }
  }

  void put_row(const Row& row, std::size_t i) { std::memcpy(&point_offsets_[i], &row, sizeof row); }

  alignas(64) std::array<Column<double>, 3> scaled_;
  alignas(64) std::array<Column<std::int32_t>, 3> cells_;
  alignas(64) std::array<Column<std::uint32_t>, 3> above_;
  alignas(64) std::array<Column<std::int32_t>, 3> offsets_;
  alignas(64) Column<std::uint64_t> keys_;
  alignas(64) Column<std::uint32_t> hashes_;
  alignas(64) Column<Offset> point_offsets_;
  alignas(64) Column<Index> points_;
  std::size_t size_ = 0;
};

}  // namespace chainslam::detail
