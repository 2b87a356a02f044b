#pragma once

#include <Eigen/Core>
#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/search/detail/growing_array.hpp"
#include "chainslam/search/detail/tile_gaps.hpp"
#include "chainslam/search/detail/voxel_block.hpp"
#include "chainslam/search/detail/voxel_runs.hpp"

namespace chainslam::detail {

/// At most one point a voxel, with its state: a hash of tiles of 4 x 4 x 4 blocks of 4 x 4 x 4 voxels (in two
/// dimensions, one layer).
///
/// A tile says in one mask which blocks there are, a block in one mask which of its voxels hold a point; the points of
/// a block lie one after the other in the order of the voxels, so that a bit's rank is its point's place.
template <class Scalar, int Dim, int StateBits>
class VoxelTileStore {
 public:
  using Vector = Eigen::Matrix<Scalar, Dim, 1>;
  using Runs = VoxelRuns<Scalar, Dim, StateBits>;
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

  [[nodiscard]] Index size() const { return size_; }
  [[nodiscard]] std::size_t memory() const {
    return table_.memory() + tiles_.memory() + blocks_.memory() + runs_.memory() +
           (free_tiles_.capacity() + free_blocks_.capacity()) * sizeof(Index);
  }
  /// Tiles, those without a block included.
  [[nodiscard]] std::size_t tiles() const { return tiles_.size(); }
  [[nodiscard]] const Tile& tile(std::size_t t) const { return tiles_[t]; }
  /// Place of the tile with a cell, or -1.
  [[nodiscard]] Index find_tile(const Cell& cell) const { return table_.find(cell); }
  [[nodiscard]] const Block& block(Index owner) const { return blocks_[static_cast<std::size_t>(owner)]; }
  [[nodiscard]] const Block& block(const Tile& tile, int place) const {
    return block(tile.block[static_cast<std::size_t>(place)]);
  }
  /// The points, by the indices that blocks give.
  [[nodiscard]] const Runs& runs() const { return runs_; }
  [[nodiscard]] Runs& runs() { return runs_; }

  [[nodiscard]] bool contains(Index i) const {
    const Index owner = runs_.owner(i);
    return owner >= 0 && i - block(owner).first < std::popcount(block(owner).occupied);
  }

  [[nodiscard]] static bool occupied(const Block& block, int voxel) { return (block.occupied >> voxel & 1) != 0; }
  /// The index of a voxel's point, or what it would be.
  [[nodiscard]] static Index index(const Block& block, int voxel) {
    return block.first + std::popcount(block.occupied & ((std::uint64_t{1} << voxel) - 1));
  }

  /// The block of a voxel's cell, or -1 if there is none. Faster after a neighbour.
  [[nodiscard]] Index find_block(const Cell& voxel) {
    const Cell block_cell = parent(voxel);
    look_for_tile(parent(block_cell));
    if (last_tile_ < 0) return -1;
    const Tile& tile = tiles_[static_cast<std::size_t>(last_tile_)];
    const int place = place_in_parent(block_cell);
    return (tile.blocks >> place & 1) != 0 ? tile.block[static_cast<std::size_t>(place)] : -1;
  }
  /// Likewise, made if there is none; it must get a point.
  [[nodiscard]] Index block_at(const Cell& voxel) {
    if (const Index there = find_block(voxel); there >= 0) return there;
    const Cell block_cell = parent(voxel);
    if (last_tile_ < 0) last_tile_ = make_tile(parent(block_cell));
    Tile& tile = tiles_[static_cast<std::size_t>(last_tile_)];
    const int place = place_in_parent(block_cell);
    const Index owner = take(free_blocks_, blocks_);
    blocks_[static_cast<std::size_t>(owner)] = {0, runs_.allocate(1, owner), last_tile_, 1,
                                                static_cast<std::uint8_t>(place)};
    tile.block[static_cast<std::size_t>(place)] = owner;
    tile.blocks |= std::uint64_t{1} << place;
    return owner;
  }

  /// Ask the memory for a block, and for the state of one of its voxels' point.
  void fetch(Index owner) const { __builtin_prefetch(&block(owner)); }
  void fetch(Index owner, int voxel) const { runs_.fetch(index(block(owner), voxel)); }

  /// Puts a point into an empty voxel.
  void add(Index owner, int voxel, const Vector& p, unsigned state) {
    Block& block = blocks_[static_cast<std::size_t>(owner)];
    const int count = std::popcount(block.occupied);
    if (count == block.chunks * Runs::lanes) {
      block.first = runs_.grow(block.first, block.chunks, owner);
      ++block.chunks;
    }
    const Index at = index(block, voxel);
    for (Index i = block.first + count; i > at; --i) runs_.move(i - 1, i);
    runs_.set(at, p, state);
    block.occupied |= std::uint64_t{1} << voxel;
    ++size_;
  }

  /// Erases the block's points for which `leaves(index, position)` holds.
  template <class Predicate>
  void filter(Index owner, Predicate&& leaves) {
    Block& block = blocks_[static_cast<std::size_t>(owner)];
    Index from = block.first, to = block.first;
    std::uint64_t kept = 0;
    for (std::uint64_t voxels = block.occupied; voxels != 0; voxels &= voxels - 1, ++from) {
      if (leaves(from, runs_.position(from))) continue;
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

  /// Calls `visit(index, position)` for each point of a tile.
  template <class Visit>
  void for_each_point(const Tile& tile, Visit&& visit) const {
    for (std::uint64_t blocks = tile.blocks; blocks != 0; blocks &= blocks - 1) {
      const Block& here = block(tile, std::countr_zero(blocks));
      const Index end = here.first + std::popcount(here.occupied);
      for (Index i = here.first; i < end; ++i) visit(i, runs_.position(i));
    }
  }

 private:
  /// Makes `last_tile_` the tile with a cell, or -1.
  void look_for_tile(const Cell& cell) {
    if (last_tile_ < 0 || !(tiles_[static_cast<std::size_t>(last_tile_)].cell == cell)) last_tile_ = find_tile(cell);
  }

  [[nodiscard]] Index make_tile(const Cell& cell) {
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

  CellTable table_;  ///< from a tile's cell to its place in tiles_
  GrowingArray<Tile> tiles_;
  GrowingArray<Block> blocks_;
  Runs runs_;
  std::vector<Index> free_tiles_;
  std::vector<Index> free_blocks_;
  Index last_tile_ = -1;  ///< the one that was last looked for
  Index size_ = 0;
};

}  // namespace chainslam::detail
