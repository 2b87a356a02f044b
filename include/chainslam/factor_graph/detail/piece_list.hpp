#pragma once

#include <cassert>
#include <cstddef>
#include <new>
#include <type_traits>
#include <utility>

#include "chainslam/core/table.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::detail {

/// The memory of a list in pieces, compiled once for all of them.
class PieceMemory {
 public:
  PieceMemory() = default;
  PieceMemory(PieceMemory&& other) noexcept : pieces_(std::move(other.pieces_)), size_(std::exchange(other.size_, 0)) {}
  PieceMemory& operator=(PieceMemory&& other) noexcept {
    std::swap(pieces_, other.pieces_);
    std::swap(size_, other.size_);
    return *this;
  }
  ~PieceMemory() { release(); }

  [[nodiscard]] Index size() const { return size_; }
  [[nodiscard]] std::byte* at(Index k, std::size_t element) const {
    assert(k >= 0 && k < size_);
    return place(k, element);
  }
  /// Memory for one element more, which counts once it is there.
  [[gnu::noinline]] std::byte* next(std::size_t element) {
    if (size_ == pieces_.size() * per_piece) {
      pieces_.reserve(pieces_.size() + 1);  // first, so that no piece is lost where there is no memory
      pieces_.push_back(static_cast<std::byte*>(::operator new(per_piece* element, alignment)));
    }
    return place(size_, element);
  }
  void count_next() { ++size_; }

  static constexpr std::align_val_t alignment{64};

 private:
  static constexpr unsigned per_piece = 16;

  [[nodiscard]] std::byte* place(Index k, std::size_t element) const {
    const auto at = static_cast<unsigned>(k);  // divided by shifts
    return pieces_[at / per_piece] + at % per_piece * element;
  }

  [[gnu::noinline]] void release() {
    for (std::byte* const piece : pieces_) ::operator delete(piece, alignment);
  }

  Table<std::byte*> pieces_;
  Index size_ = 0;
};

/// A list that grows without a copy, in time and in memory: its elements stay where they are.
template <class T>
class PieceList {
  static_assert(alignof(T) <= static_cast<std::size_t>(PieceMemory::alignment));

 public:
  PieceList() = default;
  PieceList(PieceList&&) = default;
  PieceList& operator=(PieceList&&) = default;
  ~PieceList() {
    if constexpr (!std::is_trivially_destructible_v<T>) {
      for (Index k = 0; k < size(); ++k) (*this)[k].~T();
    }
  }

  [[nodiscard]] Index size() const { return memory_.size(); }
  [[nodiscard]] T& operator[](Index k) { return *reinterpret_cast<T*>(memory_.at(k, sizeof(T))); }
  [[nodiscard]] const T& operator[](Index k) const { return *reinterpret_cast<const T*>(memory_.at(k, sizeof(T))); }
  /// @returns the new last element.
  T& add() {
    T* const made = ::new (memory_.next(sizeof(T))) T{};
    memory_.count_next();
    return *made;
  }

 private:
  PieceMemory memory_;
};

}  // namespace chainslam::detail
