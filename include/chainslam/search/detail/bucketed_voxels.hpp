#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <bit>
#include <cstdint>
#include <cstdlib>
#include <optional>
#include <stdexcept>
#include <vector>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/core/small_matrix.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/search/concepts.hpp"
#include "chainslam/search/detail/regions.hpp"
#include "chainslam/search/detail/voxel_block.hpp"
#include "chainslam/search/detail/voxel_buckets.hpp"
#include "chainslam/search/downsampling.hpp"

namespace chainslam {

namespace detail {

/// Any number of points a voxel: a hash of blocks of 4 x 4 x 4 voxels (in two dimensions, one layer).
///
/// A block says in one 64-bit mask which of its voxels hold points, so that searching touches only those; a voxel's
/// points lie in buckets of eight, in columns. Inserting costs one look into the hash, and a search where there is a
/// spacing to keep. Searching is exact up to `max_search_radius()`, beyond which nothing is found.
template <class ScalarType, int Dim>
class BucketedVoxels {
 public:
  using Scalar = ScalarType;
  using Vector = Eigen::Matrix<Scalar, Dim, 1>;
  using Options = VoxelMapOptions;

  explicit BucketedVoxels(const VoxelMapOptions& options)
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

  [[nodiscard]] const Options& options() const { return options_; }
  [[nodiscard]] Index size() const { return size_; }
  [[nodiscard]] Index rejected() const { return rejected_; }
  [[nodiscard]] Scalar max_search_radius() const { return max_search_radius_; }
  [[nodiscard]] std::size_t memory() const {
    return table_.memory() + blocks_.capacity() * sizeof(Block) + free_blocks_.capacity() * sizeof(Index) +
           buckets_.memory();
  }
  [[nodiscard]] bool contains(Index i) const { return buckets_.contains(i); }
  [[nodiscard]] Vector position(Index i) const { return buckets_.position(i); }

  bool insert(const Vector& point);
  bool erase(Index i);
  template <class Predicate>
  Index erase_if(Predicate&& leaves);
  template <class Region>
  Index erase_region(const Region& region);

  template <class Region, class Visit>
  void visit_region(const Region& region, Visit&& visit) const;
  template <class Visit>
  void for_each_point(Visit&& visit) const;
  [[nodiscard]] Eigen::AlignedBox<Scalar, Dim> bounding_box() const {
    Eigen::AlignedBox<Scalar, Dim> bounds;
    for_each_point([&](Index, const Vector& p) { bounds.extend(p); });
    return bounds;
  }
  template <class Collector>
  void search(const Vector& query, Collector& found) const;

 private:
  using Block = VoxelBlock;
  using Slabs = VoxelSlabs<Scalar>;
  static constexpr Index none = -1;
  static constexpr int max_reach = 8;

  /// Squared distances along an axis from a query to the blocks on either side of its own, of those that are near.
  struct NearSteps {
    std::array<Scalar, 2 * max_reach + 1> squared;
    std::array<int, 2 * max_reach + 1> step;  ///< ascending
    std::size_t count = 0;
  };
  using NearBlocks = std::array<NearSteps, 3>;

  [[nodiscard]] Eigen::Vector3d in_blocks(const Vector& p) const {
    Eigen::Vector3d scaled = zeros<Eigen::Vector3d>();
    for (int i = 0; i < Dim; ++i) scaled[i] = static_cast<double>(p[i]) * inverse_block_size_;
    return scaled;
  }
  [[nodiscard]] Eigen::AlignedBox<double, Dim> box(const Block& block) const {
    const Eigen::AlignedBox3d whole = block.box(block_size_);
    return {whole.min().head<Dim>(), whole.max().head<Dim>()};
  }
  [[nodiscard]] bool has_nearer_than_spacing(const Vector& point) const;
  [[nodiscard]] NearBlocks near_blocks(const Eigen::Vector3d& scaled, const Cell& cell, Scalar bound) const;
  [[nodiscard]] Block& block_at(const Cell& cell);
  template <class Erase>
  void erase_in(std::size_t place, Erase&& erase);

  template <class Collector>
  void search_ring(int ring, const Vector& query, const Eigen::Vector3d& scaled, const Cell& center,
                   const NearBlocks& near, Collector& found) const;
  template <class Collector>
  void search_voxels(const Block& block, std::uint64_t voxels, const Slabs& slabs, const Vector& query,
                     Collector& found) const;

  VoxelMapOptions options_;
  double block_size_;
  double inverse_block_size_;
  Scalar max_search_radius_;
  CellTable table_;  ///< from a block's cell to its place in blocks_
  std::vector<Block> blocks_;
  VoxelBuckets<Scalar, Dim> buckets_;  ///< the points
  std::vector<Index> free_blocks_;
  Index size_ = 0;
  Index rejected_ = 0;
};

// ---- inserting ----

template <class ScalarType, int Dim>
bool BucketedVoxels<ScalarType, Dim>::insert(const Vector& point) {
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

template <class ScalarType, int Dim>
bool BucketedVoxels<ScalarType, Dim>::has_nearer_than_spacing(const Vector& point) const {
  const auto spacing = static_cast<Scalar>(options_.min_spacing);
  AnyNearer<Scalar> found(spacing * spacing);
  search(point, found);
  return found.any();
}

template <class ScalarType, int Dim>
auto BucketedVoxels<ScalarType, Dim>::block_at(const Cell& cell) -> Block& {
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

template <class ScalarType, int Dim>
template <class Collector>
void BucketedVoxels<ScalarType, Dim>::search(const Vector& query, Collector& found) const {
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
    // Those on the query's side of its voxel first, since the nearest soon leave no room for others.
    const auto half = static_cast<Scalar>(0.5 * options_.voxel_size);
    const std::uint64_t near_side = slabs.nearer_than(half * half), around = Block::around(voxel);
    search_voxels(block, others & near_side, slabs, query, found);
    search_voxels(block, others & around & ~near_side & slabs.nearer_than(found.bound()), slabs, query, found);
    search_voxels(block, others & ~around & slabs.nearer_than(found.bound()), slabs, query, found);
  }
  const NearBlocks near = near_blocks(scaled, *center, found.bound());
  for (int ring = 1; ring <= options_.reach; ++ring) search_ring(ring, query, scaled, *center, near, found);
}

template <class ScalarType, int Dim>
auto BucketedVoxels<ScalarType, Dim>::near_blocks(const Eigen::Vector3d& scaled, const Cell& cell, Scalar bound) const
    -> NearBlocks {
  const std::array<std::int32_t, 3> own{cell.x, cell.y, cell.z};
  NearBlocks near;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    const GapAlongAxis<Scalar> gap(scaled[static_cast<Eigen::Index>(axis)], own[axis], block_size_);
    const int reach = axis < Dim ? options_.reach : 0;
    NearSteps& steps = near[axis];
    for (int step = -reach; step <= reach; ++step) {
      const Scalar squared = gap.squared(static_cast<Scalar>(step), static_cast<Scalar>(step + 1));
      steps.squared[steps.count] = squared;
      steps.step[steps.count] = step;
      steps.count += squared < bound ? 1 : 0;
    }
  }
  return near;
}

template <class ScalarType, int Dim>
template <class Collector>
void BucketedVoxels<ScalarType, Dim>::search_ring(int ring, const Vector& query, const Eigen::Vector3d& scaled,
                                                  const Cell& center, const NearBlocks& near, Collector& found) const {
  const auto& [xs, ys, zs] = near;
  for (std::size_t k = 0; k < zs.count; ++k) {
    if (std::abs(zs.step[k]) > ring) continue;
    for (std::size_t j = 0; j < ys.count; ++j) {
      const Scalar gap_yz = zs.squared[k] + ys.squared[j];
      if (std::abs(ys.step[j]) > ring || !(gap_yz < found.bound())) continue;
      const bool whole_row = std::abs(zs.step[k]) == ring || std::abs(ys.step[j]) == ring;
      for (std::size_t i = 0; i < xs.count; ++i) {
        const int from_center = std::abs(xs.step[i]);
        if (from_center > ring || (!whole_row && from_center < ring)) continue;
        if (!(gap_yz + xs.squared[i] < found.bound())) continue;
        const Index neighbor = table_.find(shifted(center, xs.step[i], ys.step[j], zs.step[k]));
        if (neighbor == none) continue;
        const Block& block = blocks_[static_cast<std::size_t>(neighbor)];
        const Slabs slabs(scaled, block.cell(), block_size_);
        search_voxels(block, block.occupied() & slabs.nearer_than(found.bound()), slabs, query, found);
      }
    }
  }
}

template <class ScalarType, int Dim>
template <class Collector>
void BucketedVoxels<ScalarType, Dim>::search_voxels(const Block& block, std::uint64_t voxels, const Slabs& slabs,
                                                    const Vector& query, Collector& found) const {
  for (; voxels != 0; voxels &= voxels - 1) {
    const int voxel = std::countr_zero(voxels);
    if (slabs.squared_distance(voxel) < found.bound()) buckets_.search(block.first_bucket(voxel), query, found);
  }
}

template <class ScalarType, int Dim>
template <class Visit>
void BucketedVoxels<ScalarType, Dim>::for_each_point(Visit&& visit) const {
  for (const Block& block : blocks_)
    for (std::uint64_t voxels = block.occupied(); voxels != 0; voxels &= voxels - 1)
      buckets_.for_each_point(block.first_bucket(std::countr_zero(voxels)), visit);
}

template <class ScalarType, int Dim>
template <class Region, class Visit>
void BucketedVoxels<ScalarType, Dim>::visit_region(const Region& region, Visit&& visit) const {
  for (const Block& block : blocks_) {
    if (block.occupied() == 0 || region.overlap(box(block)) == Overlap::outside) continue;
    for (std::uint64_t voxels = block.occupied(); voxels != 0; voxels &= voxels - 1)
      buckets_.for_each_point(block.first_bucket(std::countr_zero(voxels)), [&](Index i, const Vector& p) {
        if (region.contains(p)) visit(i, p);
      });
  }
}

// ---- erasing ----

template <class ScalarType, int Dim>
bool BucketedVoxels<ScalarType, Dim>::erase(Index i) {
  if (!contains(i)) return false;
  const Eigen::Vector3d scaled = in_blocks(position(i));
  const Cell cell = *cell_of(scaled);
  const int voxel = Block::voxel_of(scaled, cell);
  const auto place = static_cast<std::size_t>(table_.find(cell));
  erase_in(place, [&](Block& block, int other) {
    return other == voxel ? buckets_.erase_if(block, voxel, [i](Index j, const Vector&) { return j == i; }) : 0;
  });
  return true;
}

template <class ScalarType, int Dim>
template <class Predicate>
Index BucketedVoxels<ScalarType, Dim>::erase_if(Predicate&& leaves) {
  const Index before = size_;
  for (std::size_t place = 0; place < blocks_.size(); ++place)
    erase_in(place, [&](Block& block, int voxel) { return buckets_.erase_if(block, voxel, leaves); });
  return before - size_;
}

template <class ScalarType, int Dim>
template <class Region>
Index BucketedVoxels<ScalarType, Dim>::erase_region(const Region& region) {
  const Index before = size_;
  for (std::size_t place = 0; place < blocks_.size(); ++place) {
    const Overlap overlap = region.overlap(box(blocks_[place]));
    if (overlap == Overlap::outside) continue;
    erase_in(place, [&](Block& block, int voxel) {
      return overlap == Overlap::inside
                 ? buckets_.erase(block, voxel)
                 : buckets_.erase_if(block, voxel, [&](Index, const Vector& p) { return region.contains(p); });
    });
  }
  return before - size_;
}

/// Calls `erase(block, voxel)`, which says how many points went, for each voxel of a block, and frees it if it is
/// empty.
template <class ScalarType, int Dim>
template <class Erase>
void BucketedVoxels<ScalarType, Dim>::erase_in(std::size_t place, Erase&& erase) {
  Block& block = blocks_[place];
  if (block.occupied() == 0) return;
  for (std::uint64_t voxels = block.occupied(); voxels != 0; voxels &= voxels - 1)
    size_ -= erase(block, std::countr_zero(voxels));
  if (block.occupied() != 0) return;
  table_.erase(block.cell());
  free_blocks_.push_back(static_cast<Index>(place));
}

}  // namespace detail
}  // namespace chainslam
