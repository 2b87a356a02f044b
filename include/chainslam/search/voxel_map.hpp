#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <stdexcept>
#include <vector>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/cloud/concepts.hpp"
#include "chainslam/core/finite.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/detail/nearest_list.hpp"
#include "chainslam/search/detail/voxel_block.hpp"
#include "chainslam/search/detail/voxel_buckets.hpp"

namespace chainslam {

/// How a `VoxelMap` thins what it is given, and how far it looks.
struct VoxelMapOptions {
  double voxel_size = 1.0;          ///< edge, metres
  Index max_points_per_voxel = 20;  ///< further points of a full voxel are not taken
  double min_spacing = 0.1;         ///< metres; a point nearer than this to one in the map is not taken; 0 takes all
  Index reach = 1;                  ///< blocks of 4 voxels searched on each side, 1 to 8: sets `max_search_radius()`
};

/// A local map that grows by scans and is bounded by erasing: a hash of blocks of 4 x 4 x 4 voxels.
///
/// A block says in one 64-bit mask which of its voxels hold points, so that searching touches only those; a voxel's
/// points lie in buckets of eight, in columns. Inserting costs one look into the hash; nothing is ever rebuilt.
/// Searching is exact up to `max_search_radius()`, beyond which nothing is found.
///
/// Which points are kept depends on the order of insertion alone, and so does the order of `for_each_point`.
/// Indices and `position(i)` stay valid while points are inserted; erasing frees indices, which are then used again.
/// Const calls may run on several threads, but not during a change.
template <class ScalarType = float>
class VoxelMap {
 public:
  using Scalar = ScalarType;
  using Vector3 = Eigen::Matrix<Scalar, 3, 1>;
  using Box = Eigen::AlignedBox<Scalar, 3>;

  /// @throws std::invalid_argument if an option is out of range.
  explicit VoxelMap(const VoxelMapOptions& options = {});

  /// A map of the cloud's points: `insert(cloud)` into an empty map.
  template <Cloud Points>
  explicit VoxelMap(const Points& cloud, const VoxelMapOptions& options = {}) : VoxelMap(options) {
    insert(cloud);
  }

  [[nodiscard]] const VoxelMapOptions& options() const { return options_; }
  [[nodiscard]] std::size_t size() const { return static_cast<std::size_t>(size_); }
  /// Points refused because a coordinate is NaN, infinite, or 2^31 or more blocks from the origin.
  [[nodiscard]] Index rejected() const { return rejected_; }
  /// Metres; neighbours within it are found exactly, none beyond it is found.
  [[nodiscard]] Scalar max_search_radius() const { return max_search_radius_; }
  /// Bytes held, the hash table and free room included.
  [[nodiscard]] std::size_t memory() const;

  /// Takes a point unless its voxel is full or a point of the map is nearer than the spacing. Returns whether it did.
  bool insert(const Vector3& point);
  /// Inserts the points in their order. Returns how many were taken.
  template <Cloud Points>
  Index insert(const Points& cloud);

  /// Erases the points outside the closed box. Returns how many went.
  Index erase_outside(const Box& box);
  /// Erases the points whose distance from `center` exceeds `radius` (metres). Returns how many went.
  Index erase_farther_than(const Vector3& center, Scalar radius);
  void clear();

  /// Position of a point that a search has returned.
  [[nodiscard]] Vector3 position(Index i) const { return buckets_.position(i); }

  /// See `NearestNeighborSearch`; looks no farther than `max_search_radius()`.
  Index knn(const Vector3& query, std::span<Neighbor<Scalar>> out,
            Scalar max_distance = std::numeric_limits<Scalar>::infinity()) const {
    detail::NearestList<Scalar> found(out, std::min(max_distance, max_search_radius_));
    search(query, found);
    return found.size();
  }

  void within(const Vector3& query, Scalar radius, std::vector<Neighbor<Scalar>>& out) const {
    detail::RadiusList<Scalar> found(out, std::min(radius, max_search_radius_));
    search(query, found);
  }

  /// Calls `visit(index, position)` for every point, in an order that depends on the history of changes alone.
  template <class Visit>
  void for_each_point(Visit&& visit) const;

 private:
  using Block = detail::VoxelBlock;
  using Slabs = detail::VoxelSlabs<Scalar>;
  static constexpr Index none = -1;
  static constexpr int max_reach = 8;

  /// Squared distances from a query to the blocks around its own, for each axis and step.
  struct BlockGaps {
    std::array<std::array<Scalar, 2 * max_reach + 1>, 3> squared;
  };

  [[nodiscard]] Eigen::Vector3d in_blocks(const Vector3& p) const {
    return p.template cast<double>() * inverse_block_size_;
  }
  [[nodiscard]] bool has_nearer_than_spacing(const Vector3& point) const;
  [[nodiscard]] BlockGaps block_gaps(const Eigen::Vector3d& scaled, const Cell& cell) const;
  [[nodiscard]] Block& block_at(const Cell& cell);

  template <class Collector>
  void search(const Vector3& query, Collector& found) const;
  template <class Collector>
  void search_ring(int ring, const Vector3& query, const Eigen::Vector3d& scaled, const Cell& center,
                   const BlockGaps& gaps, Collector& found) const;
  template <class Collector>
  void search_voxels(const Block& block, std::uint64_t voxels, const Slabs& slabs, const Vector3& query,
                     Collector& found) const;

  template <class Region>
  Index erase_outside_region(const Region& region);

  VoxelMapOptions options_;
  double block_size_;
  double inverse_block_size_;
  Scalar max_search_radius_;
  CellTable table_;  ///< from a block's cell to its place in blocks_
  std::vector<Block> blocks_;
  detail::VoxelBuckets<Scalar> buckets_;  ///< the points
  std::vector<Index> free_blocks_;
  Index size_ = 0;
  Index rejected_ = 0;
};
static_assert(NearestNeighborSearch<VoxelMap<float>> && NearestNeighborSearch<VoxelMap<double>>);

template <class ScalarType>
VoxelMap<ScalarType>::VoxelMap(const VoxelMapOptions& options)
    : options_(options),
      block_size_(options.voxel_size * Block::edge),
      inverse_block_size_(1.0 / block_size_),
      max_search_radius_(static_cast<Scalar>(block_size_ * options.reach)) {
  if (!(options.voxel_size > 0) || !is_finite(block_size_) || !is_finite(inverse_block_size_))
    throw std::invalid_argument("VoxelMap: voxel_size must be positive and finite");
  if (options.max_points_per_voxel < 1)
    throw std::invalid_argument("VoxelMap: max_points_per_voxel must be at least 1");
  if (!(options.min_spacing >= 0)) throw std::invalid_argument("VoxelMap: min_spacing must not be negative");
  if (options.reach < 1 || options.reach > max_reach) throw std::invalid_argument("VoxelMap: reach must be 1 to 8");
  if (options.min_spacing > static_cast<double>(max_search_radius_))
    throw std::invalid_argument("VoxelMap: min_spacing exceeds max_search_radius");
}

template <class ScalarType>
std::size_t VoxelMap<ScalarType>::memory() const {
  return table_.memory() + blocks_.capacity() * sizeof(Block) + free_blocks_.capacity() * sizeof(Index) +
         buckets_.memory();
}

// ---- inserting ----

template <class ScalarType>
bool VoxelMap<ScalarType>::insert(const Vector3& point) {
  const Eigen::Vector3d scaled = in_blocks(point);
  const std::optional<Cell> cell = cell_of(scaled);
  if (!cell) {
    ++rejected_;
    return false;
  }
  const int voxel = Block::voxel_of(scaled, *cell);
  const Index found = table_.find(*cell);
  if (found != none) {
    const Block& block = blocks_[static_cast<std::size_t>(found)];
    if (buckets_.points(block.first_bucket(voxel)) >= options_.max_points_per_voxel) return false;
  }
  if (options_.min_spacing > 0 && has_nearer_than_spacing(point)) return false;
  buckets_.append(found == none ? block_at(*cell) : blocks_[static_cast<std::size_t>(found)], voxel, point);
  ++size_;
  return true;
}

template <class ScalarType>
template <Cloud Points>
Index VoxelMap<ScalarType>::insert(const Points& cloud) {
  const Index before = size_;
  const std::size_t count = cloud_size(cloud);
  for (std::size_t i = 0; i < count; ++i) insert(chainslam::position(cloud, i).template cast<Scalar>().eval());
  return size_ - before;
}

template <class ScalarType>
bool VoxelMap<ScalarType>::has_nearer_than_spacing(const Vector3& point) const {
  const auto spacing = static_cast<Scalar>(options_.min_spacing);
  detail::AnyNearer<Scalar> found(spacing * spacing);
  search(point, found);
  return found.any();
}

template <class ScalarType>
auto VoxelMap<ScalarType>::block_at(const Cell& cell) -> Block& {
  Index place;
  if (free_blocks_.empty()) {
    place = to_index(blocks_.size(), "VoxelMap");
    blocks_.emplace_back();
  } else {
    place = free_blocks_.back();
    free_blocks_.pop_back();
  }
  Block& block = blocks_[static_cast<std::size_t>(place)];
  block = Block(cell);
  table_.insert(cell, place);
  return block;
}

// ---- searching ----

template <class ScalarType>
template <class Collector>
void VoxelMap<ScalarType>::search(const Vector3& query, Collector& found) const {
  const Eigen::Vector3d scaled = in_blocks(query);
  const std::optional<Cell> center = cell_of(scaled);
  if (!center) return;
  if (const Index own = table_.find(*center); own != none) {
    const Block& block = blocks_[static_cast<std::size_t>(own)];
    const int voxel = Block::voxel_of(scaled, *center);
    buckets_.search(block.first_bucket(voxel), query, found);
    if (!(found.bound() > 0)) return;
    const std::uint64_t others = block.occupied() & ~(std::uint64_t{1} << voxel);
    const Slabs slabs(scaled, *center, block_size_);
    search_voxels(block, others & Block::around(voxel), slabs, query, found);
    search_voxels(block, others & ~Block::around(voxel), slabs, query, found);
  }
  const BlockGaps gaps = block_gaps(scaled, *center);
  for (int ring = 1; ring <= options_.reach; ++ring) search_ring(ring, query, scaled, *center, gaps, found);
}

template <class ScalarType>
auto VoxelMap<ScalarType>::block_gaps(const Eigen::Vector3d& scaled, const Cell& cell) const -> BlockGaps {
  const std::array<std::int32_t, 3> own{cell.x, cell.y, cell.z};
  BlockGaps gaps;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const detail::GapAlongAxis<Scalar> gap(scaled[static_cast<Eigen::Index>(axis)], own[axis], block_size_);
    for (int step = -options_.reach; step <= options_.reach; ++step)
      gaps.squared[axis][static_cast<std::size_t>(step + max_reach)] =
          gap.squared(static_cast<Scalar>(step), static_cast<Scalar>(step + 1));
  }
  return gaps;
}

template <class ScalarType>
template <class Collector>
void VoxelMap<ScalarType>::search_ring(int ring, const Vector3& query, const Eigen::Vector3d& scaled,
                                       const Cell& center, const BlockGaps& gaps, Collector& found) const {
  const auto gap = [&](std::size_t axis, int step) {
    return gaps.squared[axis][static_cast<std::size_t>(step + max_reach)];
  };
  for (int dz = -ring; dz <= ring; ++dz) {
    const Scalar gap_z = gap(2, dz);
    if (!(gap_z < found.bound())) continue;
    for (int dy = -ring; dy <= ring; ++dy) {
      const Scalar gap_yz = gap_z + gap(1, dy);
      if (!(gap_yz < found.bound())) continue;
      const bool whole_row = std::abs(dz) == ring || std::abs(dy) == ring;
      for (int dx = -ring; dx <= ring; dx += whole_row ? 1 : 2 * ring) {
        if (!(gap_yz + gap(0, dx) < found.bound())) continue;
        const Index neighbor = table_.find(detail::shifted(center, dx, dy, dz));
        if (neighbor == none) continue;
        const Block& block = blocks_[static_cast<std::size_t>(neighbor)];
        search_voxels(block, block.occupied(), Slabs(scaled, block.cell(), block_size_), query, found);
      }
    }
  }
}

template <class ScalarType>
template <class Collector>
void VoxelMap<ScalarType>::search_voxels(const Block& block, std::uint64_t voxels, const Slabs& slabs,
                                         const Vector3& query, Collector& found) const {
  for (; voxels != 0; voxels &= voxels - 1) {
    const int voxel = std::countr_zero(voxels);
    if (slabs.squared_distance(voxel) < found.bound()) buckets_.search(block.first_bucket(voxel), query, found);
  }
}

template <class ScalarType>
template <class Visit>
void VoxelMap<ScalarType>::for_each_point(Visit&& visit) const {
  for (const Block& block : blocks_)
    for (std::uint64_t voxels = block.occupied(); voxels != 0; voxels &= voxels - 1)
      buckets_.for_each_point(block.first_bucket(std::countr_zero(voxels)), visit);
}

// ---- erasing ----

template <class ScalarType>
Index VoxelMap<ScalarType>::erase_outside(const Box& box) {
  return erase_outside_region(detail::BoxRegion<Scalar>{box});
}

template <class ScalarType>
Index VoxelMap<ScalarType>::erase_farther_than(const Vector3& center, Scalar radius) {
  return erase_outside_region(detail::BallRegion<Scalar>{center, detail::distance_bound(radius)});
}

template <class ScalarType>
template <class Region>
Index VoxelMap<ScalarType>::erase_outside_region(const Region& region) {
  const Index before = size_;
  for (std::size_t place = 0; place < blocks_.size(); ++place) {
    Block& block = blocks_[place];
    if (block.occupied() == 0) continue;
    const detail::Overlap overlap = region.overlap(block.box(block_size_));
    if (overlap == detail::Overlap::inside) continue;
    for (std::uint64_t voxels = block.occupied(); voxels != 0; voxels &= voxels - 1) {
      const int voxel = std::countr_zero(voxels);
      size_ -= overlap == detail::Overlap::outside
                   ? buckets_.erase(block, voxel)
                   : buckets_.erase_if(block, voxel, [&](const Vector3& p) { return !region.contains(p); });
    }
    if (block.occupied() == 0) {
      table_.erase(block.cell());
      free_blocks_.push_back(static_cast<Index>(place));
    }
  }
  return before - size_;
}

template <class ScalarType>
void VoxelMap<ScalarType>::clear() {
  *this = VoxelMap(options_);
}

}  // namespace chainslam
