#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <type_traits>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/search/detail/erased_regions.hpp"
#include "chainslam/search/detail/growing_array.hpp"

namespace chainslam::detail {

/// Which voxels hold points, and a small number for each: a hash of blocks of 4 x 4 x 4 voxels with a mask.
///
/// The table grows by one bucket at a time (linear hashing, Litwin 1980), so that no insertion pays for a new table.
/// Nor does an erasure look for the blocks that it has emptied: its region is kept until `sweep` has passed all blocks,
/// and who comes to one first asks whether it still holds what it says.
template <int Dim, int StateBits>
class VoxelStates {
  static_assert(StateBits == 0 || StateBits == 4 || StateBits == 8 || StateBits == 16);

 public:
  using Box = Eigen::AlignedBox<double, Dim>;
  static constexpr int edge = 4;
  /// Blocks that a sweep looks at, once for each point offered.
  static constexpr std::size_t swept_at_once = 4;

  explicit VoxelStates(double voxel_size) : erased_(voxel_size) {}

  /// A voxel: its block's place, and which of its 64 it is.
  struct Place {
    Index block;
    unsigned voxel;
  };

  [[nodiscard]] static Cell block_of(const Cell& cell) { return {cell.x >> 2, cell.y >> 2, cell.z >> 2}; }
  [[nodiscard]] static unsigned voxel_of(const Cell& cell) {
    return static_cast<unsigned>((cell.x & 3) | (cell.y & 3) << 2 | (cell.z & 3) << 4);
  }

  /// The voxel, or block -1 if none of its block holds a point.
  [[nodiscard]] Place find(const Cell& cell) const { return {find_block(block_of(cell)), voxel_of(cell)}; }
  /// Likewise, faster after a neighbour.
  [[nodiscard]] Place find_again(const Cell& cell) {
    const Cell block = block_of(cell);
    if (!(last_ >= 0 && key(last_).block == block)) {
      last_ = find_block(block);
      if (last_ >= 0 && !erased_.empty()) catch_up(last_);
    }
    return {last_, voxel_of(cell)};
  }
  /// The voxel; its block is made if need be, and must get a point.
  [[nodiscard]] Place find_or_add(const Cell& cell) {
    const Place place = find_again(cell);
    if (place.block >= 0) return place;
    last_ = add_block(block_of(cell));
    return {last_, place.voxel};
  }

  /// Asks the memory for what `find_again` will read of a cell: its bucket,
  [[nodiscard]] std::size_t fetch_bucket(const Cell& cell) const {
    if (heads_.size() == 0) return 0;
    const std::size_t bucket = bucket_of(block_of(cell));
    __builtin_prefetch(&heads_[bucket]);
    return bucket;
  }
  /// and the first block of that.
  void fetch_block(std::size_t bucket) const {
    if (bucket >= heads_.size() || heads_[bucket] == none) return;
    const auto first = static_cast<std::size_t>(heads_[bucket]);
    __builtin_prefetch(&keys_[first]);
    __builtin_prefetch(&bodies_[first]);
  }

  [[nodiscard]] bool occupied(Place place) const { return (body(place).occupied >> place.voxel & 1U) != 0; }
  void occupy(Place place, unsigned state) {
    body(place).occupied |= std::uint64_t{1} << place.voxel;
    set_state(place, state);
  }
  /// Takes the voxel for empty, and its block away if that was the last.
  void vacate(Place place) {
    body(place).occupied &= ~(std::uint64_t{1} << place.voxel);
    if (body(place).occupied == 0) remove_block(place.block);
  }

  [[nodiscard]] unsigned state(Place place) const {
    const auto& bytes = body(place).states;
    if constexpr (StateBits == 4) return bytes[place.voxel / 2] >> (place.voxel % 2 * 4) & 15U;
    if constexpr (StateBits == 8) return bytes[place.voxel];
    if constexpr (StateBits == 16)
      return bytes[2 * place.voxel] | static_cast<unsigned>(bytes[2 * place.voxel + 1]) << 8;
    return 0;
  }
  void set_state(Place place, unsigned value) {
    [[maybe_unused]] auto& bytes = body(place).states;
    if constexpr (StateBits == 4) {
      const unsigned shift = place.voxel % 2 * 4;
      bytes[place.voxel / 2] = static_cast<std::uint8_t>((bytes[place.voxel / 2] & (0xf0U >> shift)) | value << shift);
    }
    if constexpr (StateBits == 8) bytes[place.voxel] = static_cast<std::uint8_t>(value);
    if constexpr (StateBits == 16) {
      bytes[2 * place.voxel] = static_cast<std::uint8_t>(value & 255U);
      bytes[2 * place.voxel + 1] = static_cast<std::uint8_t>(value >> 8);
    }
  }

  /// All points have been erased that lie in a region; takes the voxels for empty that lie in it as a whole.
  /// @param around  holds those points whose voxels have not been vacated
  template <class Region>
  void vacate_inside(const Region& region, const Box& around) {
    if (erased_.full()) sweep_all();
    if (erased_.empty()) start_sweep(erased_.last() + 1);
    erased_.add(region, around);
    last_ = none;
  }

  /// Looks at a few blocks, and takes away what has been erased.
  void sweep() {
    for (std::size_t i = 0; i < swept_at_once && !erased_.empty(); ++i) {
      if (next_swept_ < keys_.size()) {
        sweep(next_swept_++);
      } else {
        erased_.drop_until(sweeps_);
        start_sweep(erased_.last());
      }
    }
  }
  /// How many blocks sweeps have looked at since it was last asked to count from zero.
  [[nodiscard]] std::size_t swept() const { return swept_; }
  void reset_swept() { swept_ = 0; }

  [[nodiscard]] std::size_t memory() const {
    return heads_.memory() + keys_.memory() + bodies_.memory() + erased_.memory();
  }

 private:
  static constexpr Index none = -1;
  struct Key {
    Cell block;
    Index next;  ///< in the same bucket; of a free place, `-3 -` the next one
  };
  [[nodiscard]] static bool is_free(const Key& key) { return key.next < none; }

  struct NoStates {};
  struct Body {
    std::uint64_t occupied;
    std::uint64_t seen;  ///< number of the last erased region that it knows of
    [[no_unique_address]] std::conditional_t<
        StateBits == 0, NoStates, std::array<std::uint8_t, static_cast<std::size_t>(std::max(8 * StateBits, 1))>>
        states;
  };

  [[nodiscard]] const Body& body(Place place) const { return bodies_[static_cast<std::size_t>(place.block)]; }
  [[nodiscard]] Body& body(Place place) { return bodies_[static_cast<std::size_t>(place.block)]; }
  [[nodiscard]] Key& key(Index block) { return keys_[static_cast<std::size_t>(block)]; }

  /// Empties the voxels of a block that have been erased since it was last looked at.
  void catch_up(Index block) {
    const Cell& cell = key(block).block;
    if (!erased_.concern(cell)) return;
    Body& body = bodies_[static_cast<std::size_t>(block)];
    body.occupied &= ~erased_.gone(cell, body.occupied, body.seen);
    body.seen = erased_.last();
  }
  void sweep(std::size_t place) {
    ++swept_;
    if (is_free(keys_[place]) || !erased_.concern(keys_[place].block)) return;
    catch_up(static_cast<Index>(place));
    if (bodies_[place].occupied == 0) remove_block(static_cast<Index>(place));
  }
  void sweep_all() {
    for (std::size_t place = 0; place < keys_.size(); ++place) sweep(place);
    erased_.drop_until(erased_.last());
  }
  /// A sweep that makes all blocks know of the regions up to a number.
  void start_sweep(std::uint64_t number) {
    sweeps_ = number;
    next_swept_ = 0;
  }

  [[nodiscard]] static std::size_t hash(const Cell& block) {
    std::uint64_t h = static_cast<std::uint32_t>(block.x) * 0x9e37'79b9'7f4a'7c15U +
                      static_cast<std::uint32_t>(block.y) * 0xc2b2'ae3d'27d4'eb4fU +
                      static_cast<std::uint32_t>(block.z) * 0x1656'67b1'9e37'79f9U;
    h ^= h >> 32;
    return static_cast<std::size_t>((h * 0x9fb2'1c65'1e98'df25U) >> 32);
  }
  /// Buckets [0, heads) are there; `mask_ + 1` is the power of two that is to come.
  [[nodiscard]] std::size_t bucket_of(const Cell& block) const {
    const std::size_t h = hash(block), bucket = h & mask_;
    return bucket < heads_.size() ? bucket : bucket & (mask_ >> 1);
  }

  [[nodiscard]] Index find_block(const Cell& block) const {
    if (heads_.size() == 0) return none;
    Index i = heads_[bucket_of(block)];
    while (i != none && !(keys_[static_cast<std::size_t>(i)].block == block))
      i = keys_[static_cast<std::size_t>(i)].next;
    return i;
  }

  [[nodiscard]] Index add_block(const Cell& block) {
    Index place = free_;
    if (place == none) {
      place = to_index(keys_.size(), "voxel blocks");
      keys_.resize(keys_.size() + 1);
      bodies_.resize(bodies_.size() + 1);
      add_bucket();
    } else {
      free_ = -3 - key(place).next;
    }
    Index& head = heads_[bucket_of(block)];
    keys_[static_cast<std::size_t>(place)] = {block, head};
    bodies_[static_cast<std::size_t>(place)] = {0, erased_.last(), {}};
    head = place;
    return place;
  }

  void remove_block(Index place) {
    Index* link = &heads_[bucket_of(key(place).block)];
    while (*link != place) link = &key(*link).next;
    *link = key(place).next;
    key(place).next = -3 - free_;
    free_ = place;
    last_ = none;
  }

  /// One more bucket, which takes its blocks from the one that held them.
  void add_bucket() {
    const std::size_t added = heads_.size();
    heads_.resize(added + 1);
    heads_[added] = none;
    if (added > mask_) mask_ = 2 * mask_ + 1;
    if (added == 0) return;
    Index* link = &heads_[added & (mask_ >> 1)];
    while (*link != none) {
      Key& here = key(*link);
      if ((hash(here.block) & mask_) != added) {
        link = &here.next;
        continue;
      }
      const Index moved = *link;
      *link = here.next;
      here.next = heads_[added];
      heads_[added] = moved;
    }
  }

  GrowingArray<Index> heads_;  ///< the first block of each bucket
  GrowingArray<Key> keys_;
  GrowingArray<Body> bodies_;
  std::size_t mask_ = 0;
  Index free_ = none;
  Index last_ = none;  ///< the block that a point was last offered to
  ErasedRegions<Dim> erased_;
  std::uint64_t sweeps_ = 0;  ///< number of the last region that the sweep under way makes known everywhere
  std::size_t next_swept_ = 0;
  std::size_t swept_ = 0;
};

}  // namespace chainslam::detail
