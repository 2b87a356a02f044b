#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <bit>
#include <cstdint>

#include "chainslam/cloud/cell_table.hpp"

namespace chainslam::detail {

/// A point's voxel, and its squared distance from the voxel's centre in voxel sizes; negative if the point has no voxel
/// because it is not finite or too far away.
struct VoxelPlace {
  Cell cell;
  double offset = -1;

  [[nodiscard]] bool there() const { return offset >= 0; }
};

/// The arithmetic of `cell_of`, with one branch for all coordinates: this is done for every point offered to a map.
template <class Vector>
[[nodiscard]] inline VoxelPlace voxel_place(const Vector& p, double inverse_voxel) {
  constexpr bool has_z = Vector::RowsAtCompileTime == 3;
  const double x = static_cast<double>(p[0]) * inverse_voxel, y = static_cast<double>(p[1]) * inverse_voxel;
  double z = 0.5;
  if constexpr (has_z) z = static_cast<double>(p[2]) * inverse_voxel;
  const auto magnitude = [](double value) { return std::bit_cast<std::int64_t>(value) & 0x7fff'ffff'ffff'ffff; };
  constexpr auto limit = std::bit_cast<std::int64_t>(2147483647.0);
  if (std::max({magnitude(x), magnitude(y), magnitude(z)}) >= limit) return {};
  const auto floor = [](double value) {
    const auto truncated = static_cast<std::int32_t>(value);
    return truncated - (value < truncated ? 1 : 0);
  };
  const Cell cell{floor(x), floor(y), floor(z)};
  const double dx = x - (cell.x + 0.5), dy = y - (cell.y + 0.5), dz = z - (cell.z + 0.5);
  return {cell, dx * dx + dy * dy + dz * dz};
}

}  // namespace chainslam::detail
