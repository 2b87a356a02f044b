#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/search/detail/voxel_block.hpp"

namespace chainslam::detail {

/// The cell that holds a cell, four times as large, and the number 0 to 63 of the one in the other.
[[nodiscard]] inline Cell parent(const Cell& cell) { return {cell.x >> 2, cell.y >> 2, cell.z >> 2}; }
[[nodiscard]] inline int place_in_parent(const Cell& cell) {
  return (cell.x & 3) + 4 * (cell.y & 3) + 16 * (cell.z & 3);
}
[[nodiscard]] inline Cell child(const Cell& cell, int place) {
  return {4 * cell.x + place % 4, 4 * cell.y + place / 4 % 4, 4 * cell.z + place / 16};
}
/// How many cells apart along the axis where it is most.
[[nodiscard]] inline std::int64_t steps_apart(const Cell& a, const Cell& b) {
  const auto apart = [](std::int32_t u, std::int32_t v) { return std::abs(std::int64_t{u} - std::int64_t{v}); };
  return std::max({apart(a.x, b.x), apart(a.y, b.y), apart(a.z, b.z)});
}

/// A cell's box in the map, grown by what rounding may have moved its points.
template <int Dim>
[[nodiscard]] Eigen::AlignedBox<double, Dim> cell_box(const Cell& cell, double size) {
  const Eigen::Vector3d low(cell.x, cell.y, cell.z);
  Eigen::AlignedBox<double, Dim> box;
  for (int i = 0; i < Dim; ++i) {
    const double slack = rounding_slack(low[i]);
    box.min()[i] = (low[i] - slack) * size;
    box.max()[i] = (low[i] + 1 + slack) * size;
  }
  return box;
}

/// Calls `visit(cell)` for the cells that a box touches and those beside them, for rounding. Does nothing and returns
/// false if they are more than `at_most`.
template <int Dim, class Visit>
bool for_each_cell_near(const Eigen::AlignedBox<double, Dim>& box, double size, std::size_t at_most, Visit&& visit) {
  if (box.isEmpty()) return true;
  Eigen::Vector3d low = zeros<Eigen::Vector3d>(), high = low;
  constexpr double farthest = 1 << 28;
  double cells = Dim == 3 ? 1 : 4;
  for (int i = 0; i < Dim; ++i) {
    low[i] = box.min()[i] / size;
    high[i] = box.max()[i] / size;
    if (!(std::abs(low[i]) < farthest && std::abs(high[i]) < farthest)) return false;
    cells *= high[i] - low[i] + 4;
  }
  if (cells > static_cast<double>(at_most)) return false;
  const Cell first = *cell_of(low), last = *cell_of(high);
  constexpr int flat = Dim == 3 ? 1 : 0;
  for (std::int32_t z = first.z - flat; z <= last.z + flat; ++z)
    for (std::int32_t y = first.y - 1; y <= last.y + 1; ++y)
      for (std::int32_t x = first.x - 1; x <= last.x + 1; ++x) visit(Cell{x, y, z});
  return true;
}

/// Squared distances along each axis from a query to the four slabs of blocks of a tile; never more than those to the
/// points inside.
template <class Scalar, int Dim>
struct BlockSlabs {
  std::array<std::array<Scalar, 4>, 3> squared{};

  [[nodiscard]] Scalar distance(int place) const {
    const auto b = static_cast<std::size_t>(place);
    return squared[0][b & 3] + squared[1][(b >> 2) & 3] + squared[2][b >> 4];
  }
  /// The blocks that none of the axes puts beyond the bound.
  [[nodiscard]] std::uint64_t within(Scalar bound) const {
    constexpr std::array<std::uint64_t, 3> slab{0x1111'1111'1111'1111U, 0x000f'000f'000f'000fU, 0xffffU};
    constexpr std::array<int, 3> stride{1, 4, 16};
    std::uint64_t blocks = ~std::uint64_t{0};
    for (std::size_t axis = 0; axis < Dim; ++axis)
      for (std::size_t i = 0; i < 4; ++i)
        blocks &= squared[axis][i] < bound ? ~std::uint64_t{0} : ~(slab[axis] << (static_cast<int>(i) * stride[axis]));
    return blocks;
  }
};

/// Squared distances from a query to the tiles around one.
template <class Scalar, int Dim>
class TileGaps {
 public:
  /// @param in_tiles  the query in tile sizes.
  TileGaps(const Eigen::Vector3d& in_tiles, const Cell& tile, double tile_size)
      : gaps_{GapAlongAxis<Scalar>(in_tiles[0], tile.x, tile_size),
              GapAlongAxis<Scalar>(in_tiles[1], tile.y, tile_size),
              GapAlongAxis<Scalar>(in_tiles[2], tile.z, tile_size)} {}

  /// Along an axis, to the tiles that many steps up.
  [[nodiscard]] Scalar along(std::size_t axis, int step) const {
    return gaps_[axis].squared(static_cast<Scalar>(step), static_cast<Scalar>(step + 1));
  }
  [[nodiscard]] Scalar to_tile() const {
    Scalar sum = 0;
    for (std::size_t axis = 0; axis < Dim; ++axis) sum += along(axis, 0);
    return sum;
  }
  /// To the nearest of the tiles that are `ring` or more steps away.
  [[nodiscard]] Scalar beyond(int ring) const {
    Scalar nearest = std::min(along(0, -ring), along(0, ring));
    for (std::size_t axis = 1; axis < Dim; ++axis) nearest = std::min({nearest, along(axis, -ring), along(axis, ring)});
    return nearest;
  }
  [[nodiscard]] BlockSlabs<Scalar, Dim> slabs() const {
    BlockSlabs<Scalar, Dim> made;
    for (std::size_t axis = 0; axis < Dim; ++axis)
      for (std::size_t i = 0; i < 4; ++i)
        made.squared[axis][i] =
            gaps_[axis].squared(Scalar(0.25) * static_cast<Scalar>(i), Scalar(0.25) * static_cast<Scalar>(i + 1));
    return made;
  }

 private:
  std::array<GapAlongAxis<Scalar>, 3> gaps_;
};

}  // namespace chainslam::detail
