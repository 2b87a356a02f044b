#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cassert>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <memory>
#include <type_traits>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/core/table.hpp"

namespace chainslam::detail {

/// Memory for many arrays that come and go: taken from the system in large pieces, and used again without asking it.
///
/// Arrays that are given back become one block with free neighbours; a block that is too large is split: two-level
/// segregated fit (Masmano, Ripoll, Crespo and Real 2004, "TLSF"). Arrays are not initialised. O(1).
///
/// Arrays of a `Movable` arena have owners, by number, and move when `compact` is called; others never do.
template <class T, bool Movable = false>
class Arena {
  static_assert(std::is_trivially_copyable_v<T> && sizeof(T) <= 8 && alignof(T) <= 8);

 public:
  /// An array of `count` elements.
  [[nodiscard]] [[gnu::noinline]] T* take(Offset count, Index owner = 0) {
    const std::size_t words = words_for(count);
    std::byte* block = find(words);
    if (block == nullptr) block = add_piece(words);
    remove(block);
    Header head = read<Header>(block);
    const std::size_t rest = head.size - words;
    head.free = 0;
    if (rest >= smallest_block) {
      head.size = static_cast<std::uint32_t>(words);
      add_free(block + words * word, rest, words);
    }
    write(block, head);
    used_words_ += static_cast<Offset>(head.size);
    taken_words_ += static_cast<Offset>(head.size);
    if constexpr (Movable) write(block + word, static_cast<std::int64_t>(owner));
    return reinterpret_cast<T*>(block + front);
  }

  /// @param count  as it was taken.
  void give_back(T* array, Offset count) {
    std::byte* const block = reinterpret_cast<std::byte*>(array) - front;
    assert(read<Header>(block).free == 0 && read<Header>(block).size >= words_for(count));
    static_cast<void>(count);
    set_free(block);
  }

  /// Where more than a sixteenth of what is used lies idle between arrays, moves some of these together, by half
  /// of what was taken since the last call: what is free gathers at the pieces' ends.
  ///
  /// @param moved  (owner, array) is told where an array is now.
  template <class Moved>
  void compact(Moved&& moved) requires Movable {
    Offset budget = taken_words_ / 2;
    if (budget < 64 || pieces_.empty() || 16 * holes() <= used_words_) return;
    taken_words_ = 0;
    for (std::size_t ends = 0; budget > 0 && ends <= pieces_.size();) {
      if (at_ == nullptr) at_ = pieces_[at_piece_].get();
      const Header head = read<Header>(at_);
      std::byte* const next = at_ + head.size * word;
      budget -= 64;  // for looking
      if (head.size == 0 || (head.free != 0 && read<Header>(next).size == 0)) {
        at_piece_ = (at_piece_ + 1) % pieces_.size();
        at_ = nullptr;
        ++ends;
      } else if (head.free == 0) {
        at_ = next;
      } else {
        budget -= read<Header>(next).size;
        move_down(next);
        moved(static_cast<Index>(read<std::int64_t>(at_ + word)), reinterpret_cast<T*>(at_ + front));
        at_ += read<Header>(at_).size * word;
      }
    }
  }

  /// Elements that fit into what was taken from the system.
  [[nodiscard]] Offset capacity() const { return words_ * static_cast<Offset>(word / sizeof(T)); }
  /// Elements of the arrays that are taken, and what goes with them.
  [[nodiscard]] Offset used() const { return used_words_ * static_cast<Offset>(word / sizeof(T)); }

 private:
  static constexpr std::size_t word = 8;
  static constexpr std::size_t front = (Movable ? 2 : 1) * word;  ///< before an array: header, and owner
  static constexpr std::size_t smallest_block = 3;                ///< header and links, in words as all sizes
  static constexpr std::size_t smallest_piece = 32768;

  /// Before each block. One of size 0 ends a piece.
  struct Header {
    std::uint32_t size;         ///< header included
    std::uint32_t before : 31;  ///< size of the block before, 0 at the start of a piece
    std::uint32_t free : 1;
  };
  static_assert(sizeof(Header) == word);
  /// Behind the header of a free block: its neighbours in the list of its bin.
  struct Links {
    std::byte* next;
    std::byte* previous;
  };
  static_assert(sizeof(Links) <= (smallest_block - 1) * word);

  template <class X>
  [[nodiscard]] static X read(const std::byte* from) {
    X value;
    std::memcpy(&value, from, sizeof value);
    return value;
  }
  template <class X>
  static void write(std::byte* to, const X& value) {
    std::memcpy(to, &value, sizeof value);
  }
  [[nodiscard]] static Links links(const std::byte* block) { return read<Links>(block + word); }
  static void set_links(std::byte* block, const Links& links) { write(block + word, links); }

  [[nodiscard]] static std::size_t words_for(Offset count) {
    const std::size_t payload = (static_cast<std::size_t>(count) * sizeof(T) + word - 1) / word;
    assert(payload < (std::size_t{1} << 30));
    return std::max(smallest_block, payload + front / word);
  }

  /// Bins hold sizes of 1, 2, ... 15, and eight ranges between powers of two above.
  [[nodiscard]] static std::size_t bin_of(std::size_t size) {
    if (size < 16) return size;
    const auto shift = static_cast<std::size_t>(std::bit_width(size)) - 4;
    return shift * 8 + (size >> shift);
  }

  /// A free block that is large enough, from the first bin whose blocks all are.
  [[nodiscard]] std::byte* find(std::size_t size) const {
    if (size >= 16) size += (std::size_t{1} << (static_cast<std::size_t>(std::bit_width(size)) - 4)) - 1;
    const std::size_t bin = bin_of(size);
    std::uint64_t mask = ~std::uint64_t{0} << (bin % 64);
    for (std::size_t k = bin / 64; k < used_.size(); ++k, mask = ~std::uint64_t{0}) {
      const std::uint64_t found = used_[k] & mask;
      if (found != 0) return heads_[k * 64 + static_cast<std::size_t>(std::countr_zero(found))];
    }
    return nullptr;
  }

  /// A new piece, as one free block that is at least that large. Free blocks of two pieces never join, so pieces are
  /// few, and much larger than their arrays: what has not been used of one costs addresses, not memory.
  [[nodiscard]] [[gnu::noinline]] std::byte* add_piece(std::size_t size) {
    const std::size_t whole = std::max({4 * size, smallest_piece, static_cast<std::size_t>(words_) / 2});
    pieces_.push_back(std::make_unique_for_overwrite<std::byte[]>(whole * word));
    sizes_.push_back(whole);
    words_ += static_cast<Offset>(whole);
    std::byte* const block = pieces_.back().get();
    write(block + (whole - 1) * word, Header{0, 0, 0});
    add_free(block, whole - 1, 0);
    return block;
  }

  /// Joins a block with its free neighbours.
  [[gnu::noinline]] void set_free(std::byte* block) {
    const Header head = read<Header>(block);
    std::size_t size = head.size, before = head.before;
    used_words_ -= static_cast<Offset>(head.size);
    std::byte* const next = block + size * word;
    if (read<Header>(next).free != 0) {
      remove(next);
      size += read<Header>(next).size;
    }
    if (before != 0 && read<Header>(block - before * word).free != 0) {
      block -= before * word;
      remove(block);
      size += before;
      before = read<Header>(block).before;
    }
    if (at_ > block && at_ < block + size * word) at_ = block;
    add_free(block, size, before);
  }

  /// Words that are free between arrays, those at pieces' ends left out.
  [[nodiscard]] Offset holes() const {
    Offset at_ends = 0;
    for (std::size_t k = 0; k < pieces_.size(); ++k) {
      const std::byte* const end = pieces_[k].get() + (sizes_[k] - 1) * word;
      const Header last = read<Header>(end);
      if (last.before != 0 && read<Header>(end - last.before * word).free != 0) at_ends += last.before;
    }
    return words_ - used_words_ - at_ends;
  }

  /// Swaps a block with the free one before it.
  void move_down(std::byte* block) {
    Header head = read<Header>(block);
    std::byte* const hole = block - head.before * word;
    remove(hole);
    const auto rest = static_cast<std::uint32_t>(head.before);
    head.before = read<Header>(hole).before;
    std::memmove(hole + word, block + word, (head.size - 1) * word);
    write(hole, head);
    write(hole + head.size * word, Header{rest, head.size & 0x7fffffffU, 0});
    used_words_ += static_cast<Offset>(rest);
    set_free(hole + head.size * word);
  }

  [[gnu::noinline]] void add_free(std::byte* block, std::size_t size, std::size_t before) {
    write(block, Header{static_cast<std::uint32_t>(size), static_cast<std::uint32_t>(before) & 0x7fffffffU, 1});
    std::byte* const after = block + size * word;
    Header head = read<Header>(after);
    head.before = static_cast<std::uint32_t>(size) & 0x7fffffffU;
    write(after, head);
    const std::size_t bin = bin_of(size);
    if (heads_[bin] != nullptr) set_links(heads_[bin], {links(heads_[bin]).next, block});
    set_links(block, {heads_[bin], nullptr});
    heads_[bin] = block;
    used_[bin / 64] |= std::uint64_t{1} << (bin % 64);
  }

  /// Takes a free block out of its bin.
  [[gnu::noinline]] void remove(std::byte* block) {
    const Links of_block = links(block);
    const std::size_t bin = bin_of(read<Header>(block).size);
    if (of_block.next != nullptr) set_links(of_block.next, {links(of_block.next).next, of_block.previous});
    if (of_block.previous != nullptr) {
      set_links(of_block.previous, {of_block.next, links(of_block.previous).previous});
    } else {
      heads_[bin] = of_block.next;
      if (heads_[bin] == nullptr) used_[bin / 64] &= ~(std::uint64_t{1} << (bin % 64));
    }
  }

  std::vector<std::unique_ptr<std::byte[]>> pieces_;
  std::vector<std::size_t> sizes_;  ///< of pieces, in words
  std::array<std::byte*, 256> heads_{};
  std::array<std::uint64_t, 4> used_{};  ///< a bit for each bin that is not empty
  Offset words_ = 0;
  Offset used_words_ = 0;
  Offset taken_words_ = 0;    ///< since the last move
  std::size_t at_piece_ = 0;  ///< where to go on moving,
  std::byte* at_ = nullptr;   ///< at which block; null: the piece's first
};

}  // namespace chainslam::detail
