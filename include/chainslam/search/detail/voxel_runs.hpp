#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/search/detail/growing_array.hpp"
#include "chainslam/search/detail/point_lanes.hpp"

namespace chainslam::detail {

/// A number of `Bits` bits (0, 4, 8 or 16) for each of eight lanes.
template <int Bits>
struct LaneStates {
  static_assert(Bits == 0 || Bits == 4 || Bits == 8 || Bits == 16);
  std::array<std::uint8_t, static_cast<std::size_t>(Bits)> bytes{};

  [[nodiscard]] unsigned get(std::size_t lane) const {
    if constexpr (Bits == 4) return bytes[lane / 2] >> (lane % 2 * 4) & 15U;
    if constexpr (Bits == 8) return bytes[lane];
    if constexpr (Bits == 16) return bytes[2 * lane] | static_cast<unsigned>(bytes[2 * lane + 1]) << 8;
    return 0;
  }
  void set(std::size_t lane, unsigned state) {
    if constexpr (Bits == 4) {
      const unsigned shift = static_cast<unsigned>(lane % 2 * 4);
      const unsigned kept = bytes[lane / 2] & ~(15U << shift);
      bytes[lane / 2] = static_cast<std::uint8_t>(kept | state << shift);
    }
    if constexpr (Bits == 8) bytes[lane] = static_cast<std::uint8_t>(state);
    if constexpr (Bits == 16) {
      bytes[2 * lane] = static_cast<std::uint8_t>(state & 0xffU);
      bytes[2 * lane + 1] = static_cast<std::uint8_t>(state >> 8);
    }
  }
};

template <>
struct LaneStates<0> {
  [[nodiscard]] unsigned get(std::size_t) const { return 0; }
  void set(std::size_t, unsigned) {}
};

/// Points with their states in runs of one to eight chunks of eight, each run with an owner. Released runs are used
/// again, the last released of the same length first. Index of a point: chunk * lanes + lane.
template <class Scalar, int Dim, int StateBits>
class VoxelRuns {
 public:
  using Vector = Eigen::Matrix<Scalar, Dim, 1>;
  static constexpr int lanes = 8;
  static constexpr int max_chunks = 8;

  [[nodiscard]] std::size_t memory() const {
    std::size_t bytes = chunks_.memory() + tags_.memory();
    for (const std::vector<Index>& runs : free_) bytes += runs.capacity() * sizeof(Index);
    return bytes;
  }

  /// Whose run the index belongs to, or -1.
  [[nodiscard]] Index owner(Index i) const {
    const auto chunk = static_cast<std::size_t>(i / lanes);
    return i >= 0 && chunk < tags_.size() ? tags_[chunk].owner : -1;
  }
  [[nodiscard]] Vector position(Index i) const { return chunks_[chunk_of(i)].position(i % lanes); }
  [[nodiscard]] unsigned state(Index i) const { return tags_[chunk_of(i)].states.get(lane_of(i)); }

  /// Asks the memory for a point and its state.
  void fetch(Index i) const {
    const std::size_t chunk = chunk_of(i);
    __builtin_prefetch(&tags_[chunk]);
    __builtin_prefetch(&chunks_[chunk]);
    __builtin_prefetch(&chunks_[chunk].columns[Dim - 1]);
  }

  void set(Index i, const Vector& p, unsigned state) {
    chunks_[chunk_of(i)].set(i % lanes, p);
    tags_[chunk_of(i)].states.set(lane_of(i), state);
  }
  void move(Index from, Index to) { set(to, position(from), state(from)); }
  void clear(Index i) { chunks_[chunk_of(i)].clear(i % lanes); }

  /// A run of empty chunks; the index of its first place.
  /// @throws std::invalid_argument if there are more points than `Index` counts.
  [[nodiscard]] Index allocate(int chunks, Index owner) {
    std::vector<Index>& free = free_[static_cast<std::size_t>(chunks - 1)];
    const auto length = static_cast<std::size_t>(chunks);
    std::size_t first = chunks_.size();
    if (free.empty()) {
      static_cast<void>(to_index((first + length) * lanes, "VoxelMap"));
      chunks_.resize(first + length);
      tags_.resize(first + length);
    } else {
      first = static_cast<std::size_t>(free.back());
      free.pop_back();
    }
    for (std::size_t chunk = first; chunk < first + length; ++chunk) {
      chunks_[chunk] = Chunk();
      tags_[chunk] = {owner, {}};
    }
    return static_cast<Index>(first) * lanes;
  }

  void release(Index first, int chunks) {
    const auto begin = chunk_of(first);
    for (std::size_t chunk = begin; chunk < begin + static_cast<std::size_t>(chunks); ++chunk) tags_[chunk].owner = -1;
    free_[static_cast<std::size_t>(chunks - 1)].push_back(static_cast<Index>(begin));
  }

  /// Moves a full run into one with a chunk more. Returns where it now begins.
  [[nodiscard]] Index grow(Index first, int chunks, Index owner) {
    const Index moved = allocate(chunks + 1, owner);
    for (std::size_t i = 0; i < static_cast<std::size_t>(chunks); ++i) {
      chunks_[chunk_of(moved) + i] = chunks_[chunk_of(first) + i];
      tags_[chunk_of(moved) + i] = tags_[chunk_of(first) + i];
    }
    release(first, chunks);
    return moved;
  }

  /// Offers the first `count` points of a run.
  template <class Collector>
  void search(Index first, int count, const Vector& query, Collector& found) const {
    for (Index i = first; i < first + count; i += lanes)
      scan(chunks_[chunk_of(i)], query.data(), found, [i](int lane) { return i + lane; });
  }

 private:
  using Chunk = Lanes<Scalar, lanes, Dim>;
  struct Tag {
    Index owner;
    [[no_unique_address]] LaneStates<StateBits> states;
  };

  [[nodiscard]] static std::size_t chunk_of(Index i) { return static_cast<std::size_t>(i) / lanes; }
  [[nodiscard]] static std::size_t lane_of(Index i) { return static_cast<std::size_t>(i) % lanes; }

  GrowingArray<Chunk> chunks_;
  GrowingArray<Tag> tags_;
  std::array<std::vector<Index>, max_chunks> free_;
};

}  // namespace chainslam::detail
