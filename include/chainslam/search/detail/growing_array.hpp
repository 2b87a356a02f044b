#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <new>
#include <type_traits>
#include <utility>

namespace chainslam::detail {

/// An array that grows by an eighth, through `realloc`: a large one is moved by the system's page tables and not byte
/// by byte, so that no single step pays for a copy of everything. New elements are not set.
template <class T>
class GrowingArray {
  static_assert(std::is_trivially_copyable_v<T> && std::is_trivially_destructible_v<T>);

 public:
  GrowingArray() = default;
  GrowingArray(const GrowingArray& other) {
    resize(other.size_);
    if (size_ > 0) std::memcpy(static_cast<void*>(data_), other.data_, size_ * sizeof(T));
  }
  GrowingArray(GrowingArray&& other) noexcept { swap(other); }
  GrowingArray& operator=(GrowingArray other) noexcept {
    swap(other);
    return *this;
  }
  ~GrowingArray() { std::free(raw_); }

  void swap(GrowingArray& other) noexcept {
    std::swap(raw_, other.raw_);
    std::swap(data_, other.data_);
    std::swap(size_, other.size_);
    std::swap(capacity_, other.capacity_);
  }

  [[nodiscard]] std::size_t size() const { return size_; }
  [[nodiscard]] const T& operator[](std::size_t i) const { return data_[i]; }
  [[nodiscard]] T& operator[](std::size_t i) { return data_[i]; }
  [[nodiscard]] const T* data() const { return data_; }
  [[nodiscard]] T* data() { return data_; }
  /// Bytes held, free room included.
  [[nodiscard]] std::size_t memory() const { return capacity_ == 0 ? 0 : capacity_ * sizeof(T) + room_to_align; }

  void resize(std::size_t size) {
    if (size > capacity_) reallocate(size_ == 0 ? size : std::max(size, size_ + size_ / 8 + 4));
    size_ = size;
  }

 private:
  static constexpr std::size_t alignment = std::max(alignof(T), alignof(std::max_align_t));
  static constexpr std::size_t room_to_align = alignment > alignof(std::max_align_t) ? alignment : 0;

  void reallocate(std::size_t capacity) {
    const std::size_t shift = raw_ == nullptr ? 0 : offset();
    void* const raw = std::realloc(raw_, capacity * sizeof(T) + room_to_align);
    if (raw == nullptr) throw std::bad_alloc();
    raw_ = raw;
    const auto address = reinterpret_cast<std::uintptr_t>(raw);
    const std::size_t aligned = static_cast<std::size_t>((alignment - address % alignment) % alignment);
    auto* const bytes = static_cast<std::byte*>(raw);
    if (aligned != shift && size_ > 0) std::memmove(bytes + aligned, bytes + shift, size_ * sizeof(T));
    data_ = reinterpret_cast<T*>(bytes + aligned);
    capacity_ = capacity;
  }

  [[nodiscard]] std::size_t offset() const {
    return static_cast<std::size_t>(reinterpret_cast<std::byte*>(data_) - static_cast<std::byte*>(raw_));
  }

  void* raw_ = nullptr;
  T* data_ = nullptr;
  std::size_t size_ = 0;
  std::size_t capacity_ = 0;
};

}  // namespace chainslam::detail
