#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cassert>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <new>
#include <span>
#include <type_traits>
#include <utility>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// An arena's memory, in words of eight bytes: compiled once, whatever the arrays hold. See `Arena`.
class ArenaMemory {
 public:
  static constexpr std::size_t word = 8;

  /// A block of so many words, its header included. Behind the header is its owner, if it may be moved.
  [[nodiscard]] [[gnu::noinline]] std::byte* take(std::size_t words) {
    words = std::max(words, smallest_block);
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
    return block;
  }
  void give_back(std::byte* block, std::size_t words) {
    assert(read<Header>(block).free == 0 && read<Header>(block).size >= words);
    static_cast<void>(words);
    set_free(block);
  }
  static void set_owner(std::byte* block, Index owner) { write(block + word, static_cast<std::int64_t>(owner)); }

  /// As `Arena::compact`; `moved` is told the owner and where what follows it is now.
  template <class Moved>
  void compact(Moved&& moved) {
    Offset budget = taken_words_ / 2;
    if (budget < 64 || pieces_.all().empty() || 16 * holes() <= used_words_) return;
    taken_words_ = 0;
    for (std::size_t ends = 0; budget > 0 && ends <= pieces_.all().size();) {
      if (at_ == nullptr) at_ = pieces_.all()[at_piece_].data;
      const Header head = read<Header>(at_);
      std::byte* const next = at_ + head.size * word;
      budget -= 64;  // for looking
      if (head.size == 0 || (head.free != 0 && read<Header>(next).size == 0)) {
        at_piece_ = (at_piece_ + 1) % pieces_.all().size();
        at_ = nullptr;
        ++ends;
      } else if (head.free == 0) {
        at_ = next;
      } else {
        budget -= read<Header>(next).size;
        move_down(next);
        moved(static_cast<Index>(read<std::int64_t>(at_ + word)), at_ + 2 * word);
        at_ += read<Header>(at_).size * word;
      }
    }
  }

  [[nodiscard]] Offset words() const { return words_; }
  [[nodiscard]] Offset used_words() const { return used_words_; }

 private:
  static constexpr std::size_t smallest_block = 3;  ///< header and links, in words as all sizes
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
    std::byte* const block = pieces_.add(whole);
    words_ += static_cast<Offset>(whole);
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
    for (const Piece& piece : pieces_.all()) {
      const std::byte* const end = piece.data + (piece.words - 1) * word;
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

  struct Piece {
    std::byte* data;
    std::size_t words;
  };
  /// What was taken from the system.
  class Pieces {
   public:
    Pieces() = default;
    Pieces(Pieces&&) noexcept = default;
    Pieces& operator=(Pieces&& other) noexcept {
      std::swap(list_, other.list_);
      return *this;
    }
    ~Pieces() {
      for (const Piece& piece : list_) ::operator delete(piece.data);
    }

    [[nodiscard]] std::span<const Piece> all() const { return list_.all(); }
    [[nodiscard]] std::span<Piece> all() { return list_.all(); }
    std::byte* add(std::size_t words) {
      list_.reserve(list_.size() + 1);  // first, so that no piece is lost where there is no memory
      list_.push_back({static_cast<std::byte*>(::operator new(words* word)), words});
      return list_.back().data;
    }

   private:
    Table<Piece> list_;
  };

  Pieces pieces_;
  std::array<std::byte*, 256> heads_{};
  std::array<std::uint64_t, 4> used_{};  ///< a bit for each bin that is not empty
  Offset words_ = 0;
  Offset used_words_ = 0;
  Offset taken_words_ = 0;    ///< since the last move
  std::size_t at_piece_ = 0;  ///< where to go on moving,
  std::byte* at_ = nullptr;   ///< at which block; null: the piece's first
};

/// Memory for many arrays that come and go: taken from the system in large pieces, and used again without asking it.
///
/// Arrays that are given back become one block with free neighbours; a block that is too large is split: two-level
/// segregated fit (Masmano, Ripoll, Crespo and Real 2004, "TLSF"). Arrays are not initialized. O(1).
///
/// Arrays of a `Movable` arena have owners, by number, and move when `compact` is called; others never do.
template <class T, bool Movable = false>
class Arena {
  static_assert(std::is_trivially_copyable_v<T> && sizeof(T) <= 8 && alignof(T) <= 8);

 public:
  /// An array of `count` elements.
  [[nodiscard]] T* take(Offset count, Index owner = 0) {
    std::byte* const block = memory_.take(words_for(count));
    if constexpr (Movable) ArenaMemory::set_owner(block, owner);
    return reinterpret_cast<T*>(block + front);
  }

  /// @param count  as it was taken.
  void give_back(T* array, Offset count) {
    memory_.give_back(reinterpret_cast<std::byte*>(array) - front, words_for(count));
  }

  /// Where more than a sixteenth of what is used lies idle between arrays, moves some of these together, by half
  /// of what was taken since the last call: what is free gathers at the pieces' ends.
  ///
  /// @param moved  (owner, array) is told where an array is now.
  template <class Moved>
  void compact(Moved&& moved) requires Movable {
    memory_.compact([&](Index owner, std::byte* array) { moved(owner, reinterpret_cast<T*>(array)); });
  }

  /// Elements that fit into what was taken from the system.
  [[nodiscard]] Offset capacity() const { return memory_.words() * per_word; }
  /// Elements of the arrays that are taken, and what goes with them.
  [[nodiscard]] Offset used() const { return memory_.used_words() * per_word; }

 private:
  static constexpr std::size_t front = (Movable ? 2 : 1) * ArenaMemory::word;  ///< before an array: header, and owner
  static constexpr auto per_word = static_cast<Offset>(ArenaMemory::word / sizeof(T));

  [[nodiscard]] static std::size_t words_for(Offset count) {
    const std::size_t bytes = static_cast<std::size_t>(count) * sizeof(T) + front;
    const std::size_t words = (bytes + ArenaMemory::word - 1) / ArenaMemory::word;
    assert(words < (std::size_t{1} << 30));
    return words;
  }

  ArenaMemory memory_;
};

}  // namespace chainslam::detail
