#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/search/detail/regions.hpp"

namespace chainslam::detail {

/// Block coordinates carry at most this error, from the product that made them and the subtraction of the cell.
[[nodiscard]] inline double rounding_slack(double scaled) {
  return 4 * std::numeric_limits<double>::epsilon() * (std::abs(scaled) + 1);
}

/// Squared distances along one axis from a query to slabs about a block; never more than to a point inside the slab.
template <class Scalar>
class GapAlongAxis {
 public:
  /// @param scaled  the query's coordinate in block sizes; `cell`: the block's.
  GapAlongAxis(double scaled, std::int32_t cell, double block_size)
      : inside_(static_cast<Scalar>(scaled - cell)),
        slack_(static_cast<Scalar>(rounding_slack(scaled)) +
               4 * std::numeric_limits<Scalar>::epsilon() * (std::abs(inside_) + 1)),
        block_size_(static_cast<Scalar>(block_size)) {}

  /// To the slab [low, high], in block sizes from the block's lower face.
  [[nodiscard]] Scalar squared(Scalar low, Scalar high) const {
    const Scalar gap = std::max(std::max(low - inside_, inside_ - high) - slack_, Scalar(0)) * block_size_;
    return gap * gap * static_cast<Scalar>(below_float_rounding);
  }

 private:
  Scalar inside_;
  Scalar slack_;
  Scalar block_size_;
};

[[nodiscard]] inline Cell shifted(const Cell& cell, int dx, int dy, int dz) {
  // Wraps at the ends of the range, where no block can be: `cell_of` leaves out the outermost cells.
  const auto add = [](std::int32_t value, int step) {
    return static_cast<std::int32_t>(static_cast<std::uint32_t>(value) + static_cast<std::uint32_t>(step));
  };
  return {add(cell.x, dx), add(cell.y, dy), add(cell.z, dz)};
}

/// 4 x 4 x 4 voxels: which of them hold points, and where those are. Voxel number: x + 4 y + 16 z.
class VoxelBlock {
 public:
  static constexpr int edge = 4;

  VoxelBlock() = default;
  explicit VoxelBlock(const Cell& cell) : cell_(cell) { first_bucket_.fill(-1); }

  [[nodiscard]] const Cell& cell() const { return cell_; }
  [[nodiscard]] std::uint64_t occupied() const { return occupied_; }
  [[nodiscard]] Index first_bucket(int voxel) const { return first_bucket_[static_cast<std::size_t>(voxel)]; }
  [[nodiscard]] Index* link(int voxel) { return &first_bucket_[static_cast<std::size_t>(voxel)]; }

  void set_first_bucket(int voxel, Index bucket) {
    first_bucket_[static_cast<std::size_t>(voxel)] = bucket;
    refresh(voxel);
  }

  /// Sets the voxel's bit after its link has changed.
  void refresh(int voxel) {
    const std::uint64_t bit = std::uint64_t{1} << voxel;
    occupied_ = first_bucket(voxel) < 0 ? occupied_ & ~bit : occupied_ | bit;
  }

  /// The voxel that holds a point of this block, given in block sizes.
  [[nodiscard]] static int voxel_of(const Eigen::Vector3d& scaled, const Cell& cell) {
    const auto part = [](double inside) { return std::clamp(static_cast<int>(inside * edge), 0, edge - 1); };
    return part(scaled[0] - cell.x) + edge * part(scaled[1] - cell.y) + edge * edge * part(scaled[2] - cell.z);
  }

  /// The voxels of the block that touch a voxel, itself included.
  [[nodiscard]] static std::uint64_t around(int voxel) {
    static constexpr std::array<std::uint64_t, edge> row{0b0011, 0b0111, 0b1110, 0b1100};
    const std::uint64_t xs = row[static_cast<std::size_t>(voxel % edge)];
    std::uint64_t mask = 0;
    for (int z = std::max(voxel / 16 - 1, 0); z <= std::min(voxel / 16 + 1, edge - 1); ++z)
      for (int y = std::max(voxel / 4 % 4 - 1, 0); y <= std::min(voxel / 4 % 4 + 1, edge - 1); ++y)
        mask |= xs << (edge * y + edge * edge * z);
    return mask;
  }

  /// The block's box, grown by what rounding may have moved its points.
  [[nodiscard]] Eigen::AlignedBox3d box(double block_size) const {
    const Eigen::Vector3d low(cell_.x, cell_.y, cell_.z);
    Eigen::AlignedBox3d box;
    for (int i = 0; i < 3; ++i) {
      const double slack = rounding_slack(low[i]);
      box.min()[i] = (low[i] - slack) * block_size;
      box.max()[i] = (low[i] + 1 + slack) * block_size;
    }
    return box;
  }

 private:
  Cell cell_;
  std::uint64_t occupied_ = 0;
  std::array<Index, edge * edge * edge> first_bucket_{};
};

/// Squared distances from a query to the four slabs of voxels of a block along each axis; never more than those to the
/// points inside.
template <class Scalar>
class VoxelSlabs {
 public:
  VoxelSlabs(const Eigen::Vector3d& scaled, const Cell& cell, double block_size) {
    const std::array<std::int32_t, 3> own{cell.x, cell.y, cell.z};
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const GapAlongAxis<Scalar> gap(scaled[static_cast<Eigen::Index>(axis)], own[axis], block_size);
      for (std::size_t i = 0; i < 4; ++i)
        squared_[axis][i] =
            gap.squared(Scalar(0.25) * static_cast<Scalar>(i), Scalar(0.25) * static_cast<Scalar>(i + 1));
    }
  }

  [[nodiscard]] Scalar squared_distance(int voxel) const {
    const auto v = static_cast<std::size_t>(voxel);
    return squared_[0][v & 3] + squared_[1][(v >> 2) & 3] + squared_[2][v >> 4];
  }
  /// The voxels whose slabs are all nearer than `bound`: those nearer, and some in the corners about them.
  [[nodiscard]] std::uint64_t nearer_than(Scalar bound) const {
    const std::uint64_t xs = bits_below(0, bound), ys = bits_below(1, bound), zs = bits_below(2, bound);
    return (xs * 0x1111'1111'1111'1111U) & (spread(ys, 4) * 0xfU * 0x0001'0001'0001'0001U) & (spread(zs, 16) * 0xffffU);
  }

 private:
  [[nodiscard]] std::uint64_t bits_below(std::size_t axis, Scalar bound) const {
    std::uint64_t bits = 0;
    for (std::size_t i = 0; i < 4; ++i) bits |= static_cast<std::uint64_t>(squared_[axis][i] < bound) << i;
    return bits;
  }
  /// Four bits, `apart` places from one another.
  [[nodiscard]] static std::uint64_t spread(std::uint64_t bits, int apart) {
    return (bits & 1U) | (bits & 2U) << (apart - 1) | (bits & 4U) << 2 * (apart - 1) | (bits & 8U) << 3 * (apart - 1);
  }

  std::array<std::array<Scalar, 4>, 3> squared_;
};

/// Asks whether any point is nearer than a distance, and stops at the first.
template <class Scalar>
class AnyNearer {
 public:
  explicit AnyNearer(Scalar squared_distance) : bound_(squared_distance) {}
  [[nodiscard]] Scalar bound() const { return bound_; }
  [[nodiscard]] bool any() const { return any_; }
  void offer(Index, Scalar) {
    any_ = true;
    bound_ = 0;
  }

 private:
  Scalar bound_;
  bool any_ = false;
};

}  // namespace chainslam::detail
