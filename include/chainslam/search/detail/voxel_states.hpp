#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/core/types.hpp"
#include "chainslam/search/detail/growing_array.hpp"
#include "chainslam/search/detail/regions.hpp"

namespace chainslam::detail {

/// Which voxels hold points, and a small number for each: a hash of blocks of 4 x 4 x 4 voxels with a mask.
///
/// The table grows by one bucket at a time (linear hashing, Litwin 1980), so that no insertion pays for a new table.
template <int StateBits>
class VoxelStates {
  static_assert(StateBits == 0 || StateBits == 4 || StateBits == 8 || StateBits == 16);

 public:
  static constexpr int edge = 4;

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
    if (!(last_ >= 0 && key(last_).block == block)) last_ = find_block(block);
    return {last_, voxel_of(cell)};
  }
  /// The voxel; its block is made if need be, and must get a point.
  [[nodiscard]] Place find_or_add(const Cell& cell) {
    const Place place = find_again(cell);
    if (place.block >= 0) return place;
    last_ = add_block(block_of(cell));
    return {last_, place.voxel};
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

  /// Takes the blocks for empty that lie in a region as a whole and touch a box.
  template <int Dim, class Region>
  void vacate_inside(const Region& region, const Eigen::AlignedBox<double, Dim>& bounds, double voxel_size) {
    const BlockRange range(bounds, voxel_size * edge);
    for (std::size_t i = 0; i < keys_.size(); ++i) {
      const Key& key = keys_[i];
      if (!range.contains(key.block) || is_free(key)) continue;
      if (region.overlap(box<Dim>(key.block, voxel_size)) == Overlap::inside) remove_block(static_cast<Index>(i));
    }
  }

  /// The box of the blocks from one voxel's to another's.
  template <int Dim>
  [[nodiscard]] static Eigen::AlignedBox<double, Dim> blocks_between(const Cell& low, const Cell& high,
                                                                     double voxel_size) {
    return box<Dim>(block_of(low), voxel_size).merged(box<Dim>(block_of(high), voxel_size));
  }

  [[nodiscard]] std::size_t memory() const { return heads_.memory() + keys_.memory() + bodies_.memory(); }

 private:
  static constexpr Index none = -1;
  struct Key {
    Cell block;
    Index next;  ///< in the same bucket; of a free place, `-3 -` the next one
  };
  [[nodiscard]] static bool is_free(const Key& key) { return key.next < none; }

  /// Blocks between two corners.
  class BlockRange {
   public:
    template <int Dim>
    BlockRange(const Eigen::AlignedBox<double, Dim>& box, double block_size) {
      for (int axis = 0; axis < Dim; ++axis) {
        const auto i = static_cast<std::size_t>(axis);
        low_[i] = block(box.min()[axis] / block_size - 1);
        span_[i] =
            static_cast<std::uint32_t>(block(box.max()[axis] / block_size + 1)) - static_cast<std::uint32_t>(low_[i]);
      }
    }
    [[nodiscard]] bool contains(const Cell& cell) const {
      const auto within = [&](std::int32_t at, std::size_t axis) {
        return static_cast<std::uint32_t>(at) - static_cast<std::uint32_t>(low_[axis]) <= span_[axis];
      };
      return (int{within(cell.x, 0)} & int{within(cell.y, 1)} & int{within(cell.z, 2)}) != 0;
    }

   private:
    static std::int32_t block(double coordinate) {
      constexpr double most = 2147483647;
      return static_cast<std::int32_t>(std::clamp(std::floor(coordinate), -most, most));
    }
    std::array<std::int32_t, 3> low_{};
    std::array<std::uint32_t, 3> span_{};
  };
  struct NoStates {};
  struct Body {
    std::uint64_t occupied;
    [[no_unique_address]] std::conditional_t<
        StateBits == 0, NoStates, std::array<std::uint8_t, static_cast<std::size_t>(std::max(8 * StateBits, 1))>>
        states;
  };

  [[nodiscard]] const Body& body(Place place) const { return bodies_[static_cast<std::size_t>(place.block)]; }
  [[nodiscard]] Body& body(Place place) { return bodies_[static_cast<std::size_t>(place.block)]; }
  [[nodiscard]] Key& key(Index block) { return keys_[static_cast<std::size_t>(block)]; }

  /// The block's box, grown by what rounding may have moved its points.
  template <int Dim>
  [[nodiscard]] static Eigen::AlignedBox<double, Dim> box(const Cell& block, double voxel_size) {
    constexpr double rounding = 8 * std::numeric_limits<double>::epsilon();
    const std::array<double, 3> corner{1.0 * block.x, 1.0 * block.y, 1.0 * block.z};
    Eigen::AlignedBox<double, Dim> box;
    for (std::size_t axis = 0; axis < Dim; ++axis) {
      const double slack = rounding * (std::abs(corner[axis]) + 1);
      box.min()[static_cast<Eigen::Index>(axis)] = (corner[axis] - slack) * (edge * voxel_size);
      box.max()[static_cast<Eigen::Index>(axis)] = (corner[axis] + 1 + slack) * (edge * voxel_size);
    }
    return box;
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
    bodies_[static_cast<std::size_t>(place)] = {};
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
};

}  // namespace chainslam::detail
