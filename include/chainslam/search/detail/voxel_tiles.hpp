#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <cstdlib>
#include <optional>
#include <stdexcept>
#include <vector>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/core/finite.hpp"
#include "chainslam/search/detail/growing_array.hpp"
#include "chainslam/search/detail/tile_gaps.hpp"
#include "chainslam/search/detail/voxel_block.hpp"
#include "chainslam/search/detail/voxel_runs.hpp"
#include "chainslam/search/downsampling.hpp"

namespace chainslam::detail {

/// At most one point a voxel: a hash of tiles of 4 x 4 x 4 blocks of 4 x 4 x 4 voxels (in two dimensions, one layer).
///
/// A tile says in one mask which blocks there are, a block in one mask which of its voxels hold a point; the points of
/// a block lie one after the other in the order of the voxels, so that a bit's rank is its point's place. Meeting an
/// occupied voxel costs one look into the hash, two masks and the voxel's state. Searching is exact at any distance:
/// tiles around the query by the hash, farther ones one after the other.
template <class ScalarType, int Dim, class Policy>
class VoxelTiles {
 public:
  using Scalar = ScalarType;
  using Vector = Eigen::Matrix<Scalar, Dim, 1>;
  using Options = Policy;

  explicit VoxelTiles(const Policy& policy)
      : policy_(policy), inverse_voxel_(1.0 / policy.voxel_size), tile_size_(policy.voxel_size * edge * edge) {
    require_valid(policy);
    if (!is_finite(tile_size_)) throw std::invalid_argument("VoxelMap: voxel_size must be positive and finite");
  }

  [[nodiscard]] const Options& options() const { return policy_; }
  [[nodiscard]] Index size() const { return size_; }
  [[nodiscard]] Index rejected() const { return rejected_; }
  [[nodiscard]] std::size_t memory() const {
    return table_.memory() + tiles_.memory() + blocks_.memory() + runs_.memory() +
           (free_tiles_.capacity() + free_blocks_.capacity()) * sizeof(Index);
  }
  [[nodiscard]] bool contains(Index i) const {
    const Index owner = runs_.owner(i);
    if (owner < 0) return false;
    const Block& block = blocks_[static_cast<std::size_t>(owner)];
    return i - block.first < std::popcount(block.occupied);
  }
  [[nodiscard]] Vector position(Index i) const { return runs_.position(i); }

  bool insert(const Vector& p) {
    const Eigen::Vector3d scaled = in_voxels(p);
    const std::optional<Cell> cell = cell_of(scaled);
    if (!cell) {
      ++rejected_;
      return false;
    }
    const Index owner = block_at(*cell);
    Block& block = blocks_[static_cast<std::size_t>(owner)];
    const int voxel = place_in_parent(*cell);
    const double offset = offset_from_center(scaled, *cell);
    if ((block.occupied >> voxel & 1) != 0) return meet(block, voxel, *cell, p, offset);
    add(owner, voxel, p, policy_.first_state(offset));
    return true;
  }

  bool erase(Index i) {
    if (!contains(i)) return false;
    const Index owner = runs_.owner(i);
    filter(owner, [i](Index other, const Vector&) { return other == i; });
    return true;
  }

  template <class Predicate>
  Index erase_if(Predicate&& leaves) {
    const Index before = size_;
    for (std::size_t t = 0; t < tiles_.size(); ++t)
      for (std::uint64_t blocks = tiles_[t].blocks; blocks != 0; blocks &= blocks - 1)
        filter(tiles_[t].block[static_cast<std::size_t>(std::countr_zero(blocks))], leaves);
    return before - size_;
  }

  template <class Region>
  Index erase_region(const Region& region) {
    const Index before = size_;
    for_each_tile_near(region, [&](std::size_t t) {
      const Overlap whole = region.overlap(cell_box<Dim>(tiles_[t].cell, tile_size_));
      if (whole == Overlap::outside) return;
      for (std::uint64_t blocks = tiles_[t].blocks; blocks != 0; blocks &= blocks - 1) {
        const int place = std::countr_zero(blocks);
        const Index owner = tiles_[t].block[static_cast<std::size_t>(place)];
        const Overlap part = whole == Overlap::inside
                                 ? whole
                                 : region.overlap(cell_box<Dim>(child(tiles_[t].cell, place), tile_size_ / edge));
        if (part == Overlap::inside)
          drop(owner);
        else if (part == Overlap::partly)
          filter(owner, [&](Index, const Vector& p) { return region.contains(p); });
      }
    });
    return before - size_;
  }

  template <class Region, class Visit>
  void visit_region(const Region& region, Visit&& visit) const {
    for_each_tile_near(region, [&](std::size_t t) {
      if (region.overlap(cell_box<Dim>(tiles_[t].cell, tile_size_)) == Overlap::outside) return;
      for_each_point_of_tile(tiles_[t], [&](Index i, const Vector& p) {
        if (region.contains(p)) visit(i, p);
      });
    });
  }

  template <class Visit>
  void for_each_point(Visit&& visit) const {
    for (std::size_t t = 0; t < tiles_.size(); ++t) for_each_point_of_tile(tiles_[t], visit);
  }

  [[nodiscard]] Eigen::AlignedBox<Scalar, Dim> bounding_box() const {
    Eigen::AlignedBox<Scalar, Dim> bounds;
    for (std::size_t t = 0; t < tiles_.size(); ++t) {
      if (bounds.template cast<double>().contains(cell_box<Dim>(tiles_[t].cell, tile_size_))) continue;
      for_each_point_of_tile(tiles_[t], [&](Index, const Vector& p) { bounds.extend(p); });
    }
    return bounds;
  }

  template <class Collector>
  void search(const Vector& query, Collector& found) const {
    const Eigen::Vector3d scaled = in_voxels(query);
    const std::optional<Cell> cell = cell_of(scaled);
    const Eigen::Vector3d in_tiles = scaled / (edge * edge);
    if (!cell) {
      if (is_finite(query)) search_far(query, in_tiles, std::nullopt, 0, found);
      return;
    }
    const Cell center = parent(parent(*cell));
    if (const Index own = table_.find(center); own >= 0)
      search_from(tiles_[static_cast<std::size_t>(own)], place_in_parent(parent(*cell)), query, in_tiles, found);
    const Gaps gaps(in_tiles, center, tile_size_);
    constexpr int last_ring = 2;
    for (int ring = 1; ring <= last_ring; ++ring) {
      if (!(gaps.beyond(ring) < found.bound())) return;
      search_ring(ring, query, in_tiles, center, gaps, found);
    }
    if (gaps.beyond(last_ring + 1) < found.bound()) search_far(query, in_tiles, center, last_ring, found);
  }

 private:
  static constexpr int edge = VoxelBlock::edge;

  struct Block {
    std::uint64_t occupied;
    Index first;  ///< index of the first point
    Index tile;
    std::uint8_t chunks;  ///< room, in chunks
    std::uint8_t place;   ///< in the tile
  };
  struct Tile {
    std::uint64_t blocks;
    Cell cell;
    std::array<Index, edge * edge * edge> block;
  };
  using Gaps = TileGaps<Scalar, Dim>;
  using Slabs = BlockSlabs<Scalar, Dim>;
  using Runs = VoxelRuns<Scalar, Dim, Policy::state_bits>;

  [[nodiscard]] Eigen::Vector3d in_voxels(const Vector& p) const {
    Eigen::Vector3d scaled = Eigen::Vector3d::Zero();
    scaled.head<Dim>() = p.template cast<double>() * inverse_voxel_;
    return scaled;
  }
  [[nodiscard]] static double offset_from_center(const Eigen::Vector3d& scaled, const Cell& cell) {
    const Eigen::Vector3d center(cell.x + 0.5, cell.y + 0.5, cell.z + 0.5);
    return (scaled - center).template head<Dim>().squaredNorm();
  }

  // ---- changing ----

  /// The block of a voxel's cell, made if there is none.
  [[nodiscard]] Index block_at(const Cell& voxel) {
    const Cell block_cell = parent(voxel), tile_cell = parent(block_cell);
    const bool again = last_tile_ >= 0 && tiles_[static_cast<std::size_t>(last_tile_)].cell == tile_cell;
    if (!again) last_tile_ = tile_at(tile_cell);
    Tile& tile = tiles_[static_cast<std::size_t>(last_tile_)];
    const int place = place_in_parent(block_cell);
    Index& owner = tile.block[static_cast<std::size_t>(place)];
    if ((tile.blocks >> place & 1) != 0) return owner;
    owner = take(free_blocks_, blocks_);
    blocks_[static_cast<std::size_t>(owner)] = {0, runs_.allocate(1, owner), last_tile_, 1,
                                                static_cast<std::uint8_t>(place)};
    tile.blocks |= std::uint64_t{1} << place;
    return owner;
  }

  [[nodiscard]] Index tile_at(const Cell& cell) {
    if (const Index there = table_.find(cell); there >= 0) return there;
    const Index made = take(free_tiles_, tiles_);
    tiles_[static_cast<std::size_t>(made)].blocks = 0;
    tiles_[static_cast<std::size_t>(made)].cell = cell;
    table_.insert(cell, made);
    return made;
  }

  template <class T>
  [[nodiscard]] static Index take(std::vector<Index>& free, GrowingArray<T>& all) {
    if (free.empty()) {
      all.resize(all.size() + 1);
      return to_index(all.size(), "VoxelMap") - 1;
    }
    const Index place = free.back();
    free.pop_back();
    return place;
  }

  [[nodiscard]] static int rank(const Block& block, int voxel) {
    return std::popcount(block.occupied & ((std::uint64_t{1} << voxel) - 1));
  }

  void add(Index owner, int voxel, const Vector& p, unsigned state) {
    Block& block = blocks_[static_cast<std::size_t>(owner)];
    const int count = std::popcount(block.occupied);
    if (count == block.chunks * Runs::lanes) {
      block.first = runs_.grow(block.first, block.chunks, owner);
      ++block.chunks;
    }
    const Index at = block.first + rank(block, voxel);
    for (Index i = block.first + count; i > at; --i) runs_.move(i - 1, i);
    runs_.set(at, p, state);
    block.occupied |= std::uint64_t{1} << voxel;
    ++size_;
  }

  /// A point that came to an occupied voxel. Returns whether it has become the voxel's point.
  bool meet(Block& block, int voxel, const Cell& cell, const Vector& p, double offset) {
    const Index i = block.first + rank(block, voxel);
    unsigned state = runs_.state(i);
    if (policy_.judge(state, offset) != VoxelVerdict::meet) return false;
    if constexpr (requires(Vector & held) { policy_.meet(state, held, offset, p, offset); }) {
      Vector held = position(i);
      const bool changes = policy_.meet(state, held, offset_from_center(in_voxels(held), cell), p, offset);
      // A mean may be rounded out of its voxel; then the point stays where it was.
      const bool inside = changes && cell_of(in_voxels(held)) == std::optional(cell);
      runs_.set(i, inside ? held : position(i), state);
      return inside && held == p;
    }
    return false;
  }

  /// Erases the block's points for which `leaves(index, position)` holds.
  template <class Predicate>
  void filter(Index owner, Predicate&& leaves) {
    Block& block = blocks_[static_cast<std::size_t>(owner)];
    Index from = block.first, to = block.first;
    std::uint64_t kept = 0;
    for (std::uint64_t voxels = block.occupied; voxels != 0; voxels &= voxels - 1, ++from) {
      if (leaves(from, position(from))) continue;
      kept |= voxels & (~voxels + 1);
      if (to != from) runs_.move(from, to);
      ++to;
    }
    size_ -= from - to;
    for (Index i = to; i < from; ++i) runs_.clear(i);
    block.occupied = kept;
    if (kept == 0) drop(owner);
  }

  /// Erases the whole block.
  void drop(Index owner) {
    Block& block = blocks_[static_cast<std::size_t>(owner)];
    size_ -= std::popcount(block.occupied);
    block.occupied = 0;
    runs_.release(block.first, block.chunks);
    free_blocks_.push_back(owner);
    Tile& tile = tiles_[static_cast<std::size_t>(block.tile)];
    tile.blocks &= ~(std::uint64_t{1} << block.place);
    if (tile.blocks != 0) return;
    table_.erase(tile.cell);
    free_tiles_.push_back(block.tile);
    last_tile_ = -1;
  }

  // ---- visiting ----

  template <class Visit>
  void for_each_point_of_tile(const Tile& tile, Visit&& visit) const {
    for (std::uint64_t blocks = tile.blocks; blocks != 0; blocks &= blocks - 1) {
      const Block& block =
          blocks_[static_cast<std::size_t>(tile.block[static_cast<std::size_t>(std::countr_zero(blocks))])];
      const Index end = block.first + std::popcount(block.occupied);
      for (Index i = block.first; i < end; ++i) visit(i, position(i));
    }
  }

  /// Calls `visit(t)` for the tiles that may hold points of a region: through the hash where it has bounds and they are
  /// few, otherwise for all.
  template <class Region, class Visit>
  void for_each_tile_near(const Region& region, Visit&& visit) const {
    if constexpr (requires { region.bounds(); }) {
      const auto look = [&](const Cell& cell) {
        if (const Index t = table_.find(cell); t >= 0) visit(static_cast<std::size_t>(t));
      };
      if (for_each_cell_near<Dim>(region.bounds(), tile_size_, tiles_.size(), look)) return;
    }
    for (std::size_t t = 0; t < tiles_.size(); ++t) visit(t);
  }

  // ---- searching ----

  template <class Collector>
  void search_blocks(const Tile& tile, std::uint64_t blocks, const Slabs& slabs, const Vector& query,
                     Collector& found) const {
    for (blocks &= slabs.within(found.bound()); blocks != 0; blocks &= blocks - 1) {
      const int place = std::countr_zero(blocks);
      if (!(slabs.distance(place) < found.bound())) continue;
      const Block& block = blocks_[static_cast<std::size_t>(tile.block[static_cast<std::size_t>(place)])];
      runs_.search(block.first, std::popcount(block.occupied), query, found);
    }
  }

  /// The query's own tile: first its own block, then those around it.
  template <class Collector>
  void search_from(const Tile& tile, int place, const Vector& query, const Eigen::Vector3d& in_tiles,
                   Collector& found) const {
    const Slabs slabs = Gaps(in_tiles, tile.cell, tile_size_).slabs();
    const std::uint64_t own = std::uint64_t{1} << place, around = VoxelBlock::around(place);
    search_blocks(tile, tile.blocks & own, slabs, query, found);
    search_blocks(tile, tile.blocks & around & ~own, slabs, query, found);
    search_blocks(tile, tile.blocks & ~around, slabs, query, found);
  }

  /// The tiles `ring` steps away.
  template <class Collector>
  void search_ring(int ring, const Vector& query, const Eigen::Vector3d& in_tiles, const Cell& center, const Gaps& gaps,
                   Collector& found) const {
    const int layers = Dim == 3 ? ring : 0;
    for (int dz = -layers; dz <= layers; ++dz) {
      const Scalar gap_z = Dim == 3 ? gaps.along(2, dz) : 0;
      if (!(gap_z < found.bound())) continue;
      for (int dy = -ring; dy <= ring; ++dy) {
        const Scalar gap_yz = gap_z + gaps.along(1, dy);
        if (!(gap_yz < found.bound())) continue;
        const bool whole_row = std::abs(dz) == ring || std::abs(dy) == ring;
        for (int dx = -ring; dx <= ring; dx += whole_row ? 1 : 2 * ring) {
          if (!(gap_yz + gaps.along(0, dx) < found.bound())) continue;
          const Index t = table_.find(shifted(center, dx, dy, dz));
          if (t >= 0) search_tile(tiles_[static_cast<std::size_t>(t)], query, in_tiles, found);
        }
      }
    }
  }

  template <class Collector>
  void search_tile(const Tile& tile, const Vector& query, const Eigen::Vector3d& in_tiles, Collector& found) const {
    search_blocks(tile, tile.blocks, Gaps(in_tiles, tile.cell, tile_size_).slabs(), query, found);
  }

  /// All tiles but those at most `ring` steps from the center, in shells whose radius doubles.
  template <class Collector>
  void search_far(const Vector& query, const Eigen::Vector3d& in_tiles, const std::optional<Cell>& center, int ring,
                  Collector& found) const {
    const auto size = static_cast<Scalar>(tile_size_);
    Scalar from = -1;
    for (Scalar to = 4 * static_cast<Scalar>((ring + 1) * (ring + 1)) * size * size; from < found.bound();) {
      bool any_beyond = false;
      for (std::size_t t = 0; t < tiles_.size(); ++t) {
        const Tile& tile = tiles_[t];
        if (tile.blocks == 0 || (center && steps_apart(*center, tile.cell) <= ring)) continue;
        const Scalar distance = Gaps(in_tiles, tile.cell, tile_size_).to_tile();
        any_beyond = any_beyond || distance >= to;
        if (distance >= from && distance < to && distance < found.bound()) search_tile(tile, query, in_tiles, found);
      }
      if (!any_beyond) return;
      from = to;
      to = 4 * to;
    }
  }

  Policy policy_;
  double inverse_voxel_;
  double tile_size_;
  CellTable table_;  ///< from a tile's cell to its place in tiles_
  GrowingArray<Tile> tiles_;
  GrowingArray<Block> blocks_;
  Runs runs_;  ///< the points
  std::vector<Index> free_tiles_;
  std::vector<Index> free_blocks_;
  Index last_tile_ = -1;  ///< where the last point went
  Index size_ = 0;
  Index rejected_ = 0;
};

}  // namespace chainslam::detail
