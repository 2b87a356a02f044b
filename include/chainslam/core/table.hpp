#pragma once

#include <algorithm>
#include <cassert>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <new>
#include <span>
#include <type_traits>
#include <utility>

namespace chainslam {

/// Position in a list that may outgrow `Index`: blocks of a matrix, coefficients of a factor.
using Offset = std::int64_t;

}  // namespace chainslam

namespace chainslam::detail {

/// A table's memory. How it grows does not depend on what it holds, and is compiled once for all of them.
struct TableMemory {
  void* data = nullptr;
  Offset size = 0;  ///< in elements, as `capacity`
  Offset capacity = 0;

  /// Takes memory for at least `count` elements, and for twice as many as before.
  [[gnu::noinline]] void grow(Offset count, std::size_t element, std::size_t alignment) {
    const Offset larger = std::max(count, 2 * capacity);
    const std::size_t bytes = static_cast<std::size_t>(larger) * element;
    void* grown;
    if (alignment <= alignof(std::max_align_t)) {
      grown = std::realloc(data, bytes);
    } else {
      grown = std::aligned_alloc(alignment, bytes);
      if (grown != nullptr && data != nullptr) {
        std::memcpy(grown, data, static_cast<std::size_t>(size) * element);
        std::free(data);
      }
    }
    if (grown == nullptr) throw std::bad_alloc();
    data = grown;
    capacity = larger;
  }
  /// Holds as many elements as another one from now on, and the same.
  [[gnu::noinline]] void copy(const TableMemory& other, std::size_t element, std::size_t alignment) {
    size = 0;
    if (other.size > capacity) grow(other.size, element, alignment);
    size = other.size;
    if (size > 0) std::memcpy(data, other.data, static_cast<std::size_t>(size) * element);
  }
};

/// A vector counted in signed numbers, as the sparse algorithms count their columns and blocks. Its elements are data
/// that nothing has to destroy: numbers, and structs and small matrices of them. So it costs a quarter of what a
/// `std::vector` that grows costs to compile for another type. For use inside the library; what users hold is a
/// `std::vector`.
template <class T>
class Table {
  static_assert(std::is_copy_constructible_v<T> && std::is_trivially_destructible_v<T>);
  static constexpr bool bytes = std::is_trivially_copyable_v<T>;  ///< are all that there is to copy

 public:
  using value_type = T;

  Table() = default;
  explicit Table(Offset size, const T& value = T{}) { resize(size, value); }
  explicit Table(std::span<const T> values) { append(values); }
  Table(const Table& other) { copy(other); }
  Table(Table&& other) noexcept : memory_(std::exchange(other.memory_, {})) {}
  Table& operator=(const Table& other) {
    if (this != &other) copy(other);
    return *this;
  }
  Table& operator=(Table&& other) noexcept {
    std::swap(memory_, other.memory_);
    other.clear();
    return *this;
  }
  ~Table() { std::free(memory_.data); }

  // Written out rather than in terms of one another: each call would be one more for the compiler to inline.
  // Indices are checked where those of the standard library's containers are: as assertions they cost a program of the
  // back end a twentieth of its compile time.
  [[nodiscard]] T& operator[](Offset i) {
#ifdef _GLIBCXX_ASSERTIONS
    assert(i >= 0 && i < memory_.size);
#endif
    return static_cast<T*>(memory_.data)[i];
  }
  [[nodiscard]] const T& operator[](Offset i) const {
#ifdef _GLIBCXX_ASSERTIONS
    assert(i >= 0 && i < memory_.size);
#endif
    return static_cast<const T*>(memory_.data)[i];
  }

  [[nodiscard]] Offset size() const { return memory_.size; }
  [[nodiscard]] Offset capacity() const { return memory_.capacity; }
  [[nodiscard]] bool empty() const { return memory_.size == 0; }
  [[nodiscard]] T* data() { return static_cast<T*>(memory_.data); }
  [[nodiscard]] const T* data() const { return static_cast<const T*>(memory_.data); }
  [[nodiscard]] T& back() { return static_cast<T*>(memory_.data)[memory_.size - 1]; }
  [[nodiscard]] const T& back() const { return static_cast<const T*>(memory_.data)[memory_.size - 1]; }

  void clear() { memory_.size = 0; }
  void reserve(Offset capacity) {
    if (capacity > memory_.capacity) grow(capacity);
  }
  // A value may be an element of this table, whose memory moves.
  void assign(Offset size, const T& value) {
    const T copy = value;
    memory_.size = 0;
    resize(size, copy);
  }
  [[gnu::noinline]] void resize(Offset size, const T& value = T{}) {
    const T copy = value;
    if (size > memory_.capacity) grow(size);
    T* const elements = static_cast<T*>(memory_.data);
    for (Offset k = memory_.size; k < size; ++k) ::new (static_cast<void*>(elements + k)) T(copy);
    memory_.size = size;
  }
  void push_back(const T& value) {
    const T copy = value;
    if (memory_.size == memory_.capacity) grow(memory_.size + 1);
    ::new (static_cast<void*>(static_cast<T*>(memory_.data) + memory_.size++)) T(copy);
  }
  T& emplace_back() {
    if (memory_.size == memory_.capacity) grow(memory_.size + 1);
    return *::new (static_cast<void*>(static_cast<T*>(memory_.data) + memory_.size++)) T{};
  }
  void pop_back() {
    assert(memory_.size > 0);
    --memory_.size;
  }
  /// Leaves those elements, in their order, for which `kept(element)` is true.
  template <class Kept>
  void keep_if(Kept&& kept) {
    T* const elements = static_cast<T*>(memory_.data);
    Offset count = 0;
    for (Offset k = 0; k < memory_.size; ++k)
      if (kept(elements[k])) elements[count++] = elements[k];
    memory_.size = count;
  }
  /// @param values  not of this table.
  [[gnu::noinline]] void append(std::span<const T> values) {
    const auto count = static_cast<Offset>(values.size());
    if (memory_.size + count > memory_.capacity) grow(memory_.size + count);
    T* const end = static_cast<T*>(memory_.data) + memory_.size;
    if constexpr (bytes) {
      if (count > 0) std::memcpy(end, values.data(), static_cast<std::size_t>(count) * sizeof(T));
    } else {
      for (Offset k = 0; k < count; ++k) ::new (static_cast<void*>(end + k)) T(values.data()[k]);
    }
    memory_.size += count;
  }

  [[nodiscard]] std::span<const T> range(Offset begin, Offset end) const {
    return {static_cast<const T*>(memory_.data) + begin, static_cast<std::size_t>(end - begin)};
  }
  [[nodiscard]] std::span<T> range(Offset begin, Offset end) {
    return {static_cast<T*>(memory_.data) + begin, static_cast<std::size_t>(end - begin)};
  }
  [[nodiscard]] std::span<const T> all() const {
    return {static_cast<const T*>(memory_.data), static_cast<std::size_t>(memory_.size)};
  }
  [[nodiscard]] std::span<T> all() { return {static_cast<T*>(memory_.data), static_cast<std::size_t>(memory_.size)}; }

  [[nodiscard]] T* begin() { return static_cast<T*>(memory_.data); }
  [[nodiscard]] T* end() { return static_cast<T*>(memory_.data) + memory_.size; }
  [[nodiscard]] const T* begin() const { return static_cast<const T*>(memory_.data); }
  [[nodiscard]] const T* end() const { return static_cast<const T*>(memory_.data) + memory_.size; }

 private:
  void copy(const Table& other) {
    if constexpr (bytes) {
      memory_.copy(other.memory_, sizeof(T), alignof(T));
    } else {
      memory_.size = 0;
      append(other.all());
    }
  }
  void grow(Offset count) {
    if constexpr (bytes) {
      memory_.grow(count, sizeof(T), alignof(T));
    } else {
      grow_by_element(count);
    }
  }
  [[gnu::noinline]] void grow_by_element(Offset count) {
    Table larger;
    larger.memory_.grow(std::max(count, 2 * memory_.capacity), sizeof(T), alignof(T));
    larger.append(all());
    std::swap(memory_, larger.memory_);
  }

  TableMemory memory_;
};

}  // namespace chainslam::detail
