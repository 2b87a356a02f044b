#pragma once

#include <algorithm>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include "chainslam/sparse/detail/table.hpp"

namespace chainslam::detail {

/// Memory for many arrays that come and go: taken from the system in large pieces, and used again without asking it.
///
/// Arrays are rounded up to one of eight sizes between powers of two, and wait in a list of their size when given back.
/// They do not move, and are not initialised. O(1).
template <class T>
class Arena {
 public:
  /// An array of at least `count` elements; give it back with the same count.
  [[nodiscard]] T* take(Offset count) {
    const std::size_t size = size_class(count);
    if (size < free_.size() && !free_[size].empty()) {
      T* const array = free_[size].back();
      free_[size].pop_back();
      return array;
    }
    const Offset rounded = class_size(size);
    if (rounded > left_) {
      const Offset piece = std::max(rounded, smallest_piece);
      pieces_.push_back(std::make_unique_for_overwrite<T[]>(static_cast<std::size_t>(piece)));
      total_ += piece;
      if (piece - rounded <= left_) return pieces_.back().get();
      next_ = pieces_.back().get();
      left_ = piece;
    }
    T* const array = next_;
    next_ += rounded;
    left_ -= rounded;
    return array;
  }

  void give_back(T* array, Offset count) {
    const std::size_t size = size_class(count);
    if (size >= free_.size()) free_.resize(size + 1);
    free_[size].push_back(array);
  }

  /// Elements taken from the system.
  [[nodiscard]] Offset capacity() const { return total_; }

 private:
  static constexpr Offset smallest_piece = 32768;

  /// Sizes are 8, 9, ... 15 times a power of two, and 1 ... 7.
  [[nodiscard]] static std::size_t size_class(Offset count) {
    const auto wanted = static_cast<std::uint64_t>(std::max<Offset>(count, 1));
    if (wanted < 16) return static_cast<std::size_t>(wanted);
    const int shift = static_cast<int>(std::bit_width(wanted - 1)) - 4;
    const std::uint64_t eighths = ((wanted - 1) >> shift) + 1;  // 9 ... 16
    return static_cast<std::size_t>(shift) * 8 + static_cast<std::size_t>(eighths);
  }
  [[nodiscard]] static Offset class_size(std::size_t size) {
    if (size < 16) return static_cast<Offset>(size);
    const std::size_t shift = (size - 9) / 8;
    return static_cast<Offset>((size - shift * 8) << shift);
  }

  std::vector<std::unique_ptr<T[]>> pieces_;
  std::vector<std::vector<T*>> free_;
  T* next_ = nullptr;
  Offset left_ = 0;
  Offset total_ = 0;
};

}  // namespace chainslam::detail
