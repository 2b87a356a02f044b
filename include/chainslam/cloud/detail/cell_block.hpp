#pragma once

#include <Eigen/Core>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/cloud/concepts.hpp"

namespace chainslam::detail {

/// A cell and its hash, 16 bytes that are compared as two numbers.
struct alignas(16) HashedCell {
  Cell cell;
  std::uint32_t hash = 0;

  friend bool operator==(const HashedCell& a, const HashedCell& b) {
    using Halves = std::array<std::uint64_t, 2>;
    const Halves left = std::bit_cast<Halves>(a), right = std::bit_cast<Halves>(b);
    return ((left[0] ^ right[0]) | (left[1] ^ right[1])) == 0;
  }
};

/// The cells of a few hundred points at a time: reckoned in columns, so that the compiler works on several at once, and
/// given point by point.
class CellBlock {
 public:
  static constexpr std::size_t capacity = 256;
  static constexpr double offset_scale = 4294967296.0;  ///< 2^32: offsets an edge

  /// Where a point lies in its cell: from the centre, in 2^-32 of the edge, rounded towards the centre; and a one.
  /// These are whole numbers, so that their sums depend on neither the order of the points nor the number of threads.
  using Offset = std::array<std::int32_t, 4>;

  /// Takes points [begin, begin + count), count <= capacity; a cell is floor(p * inverse_size), in double.
  template <Cloud Points>
  void assign(const Points& cloud, std::size_t begin, std::size_t count, double inverse_size) {
    for (std::size_t i = 0; i < count; ++i) {
      const Eigen::Vector3d p = position(cloud, begin + i);
      for (std::size_t axis = 0; axis < 3; ++axis) scaled_[axis][i] = p[static_cast<Eigen::Index>(axis)] * inverse_size;
    }
    inside_.fill(1);
    for (std::size_t axis = 0; axis < 3; ++axis) split(scaled_[axis], cells_[axis], offsets_[axis], count);
    for (std::size_t i = 0; i < count; ++i) {
      const std::int32_t x = cells_[0][i], y = cells_[1][i], z = cells_[2][i];
      std::uint32_t h = static_cast<std::uint32_t>(x >> 1) * 0x9e37'79b1U +
                        static_cast<std::uint32_t>(y >> 1) * 0x85eb'ca77U +
                        static_cast<std::uint32_t>(z >> 1) * 0xc2b2'ae3dU;
      h ^= h >> 15;
      h *= 0x2c1b'3c6dU;
      const auto octant = static_cast<std::uint32_t>((x & 1) | (y & 1) << 1 | (z & 1) << 2);
      hashed_[i] = {{x, y, z}, (h & ~7U) | octant};
    }
    for (std::size_t i = 0; i < count; ++i) point_offsets_[i] = {offsets_[0][i], offsets_[1][i], offsets_[2][i], 1};
  }

  /// Whether point i has a cell: it is finite and less than 2^31 cells from the origin.
  [[nodiscard]] bool inside(std::size_t i) const { return inside_[i] != 0; }
  /// Its cell. The hash is that of the cube of eight cells, and in its three lowest bits which of them the cell is.
  [[nodiscard]] const HashedCell& cell(std::size_t i) const { return hashed_[i]; }
  [[nodiscard]] const Offset& offset(std::size_t i) const { return point_offsets_[i]; }
  [[nodiscard]] double squared_offset(std::size_t i) const {
    const double x = offsets_[0][i], y = offsets_[1][i], z = offsets_[2][i];
    return x * x + y * y + z * z;
  }

 private:
  template <class T>
  using Column = std::array<T, capacity>;

  void split(const Column<double>& scaled, Column<std::int32_t>& cells, Column<std::int32_t>& offsets,
             std::size_t count) {
    // Bits are compared, which is right for NaN under -ffast-math, too.
    constexpr auto magnitude = std::int64_t{0x7fff'ffff'ffff'ffff};
    constexpr double largest_offset = 2147483647.0;
    constexpr auto limit = std::bit_cast<std::int64_t>(2147483647.0);
    for (std::size_t i = 0; i < count; ++i) {
      const auto bits = std::bit_cast<std::int64_t>(scaled[i]);
      const std::int64_t inside = (bits & magnitude) < limit ? -1 : 0;
      const auto v = std::bit_cast<double>(bits & inside);
      const auto truncated = static_cast<std::int32_t>(v);
      const std::int32_t cell = truncated - (v < truncated ? 1 : 0);
      cells[i] = cell;
      // Just below a whole number, v - cell rounds to 1.
      const double offset = (v - cell - 0.5) * offset_scale;
      offsets[i] = static_cast<std::int32_t>(offset < largest_offset ? offset : largest_offset);
      inside_[i] &= static_cast<std::uint32_t>(inside);
    }
  }

  alignas(64) std::array<Column<double>, 3> scaled_;
  alignas(64) std::array<Column<std::int32_t>, 3> cells_;
  alignas(64) std::array<Column<std::int32_t>, 3> offsets_;
  alignas(64) Column<std::uint32_t> inside_;
  alignas(64) Column<HashedCell> hashed_;
  alignas(64) Column<Offset> point_offsets_;
};

}  // namespace chainslam::detail
