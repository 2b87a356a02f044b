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
  [[gnu::noinline]] void grow(Offset count, std::size_t element) {
    const Offset larger = std::max(count, 2 * capacity);
    void* const grown = std::realloc(data, static_cast<std::size_t>(larger) * element);
    if (grown == nullptr) throw std::bad_alloc();
    data = grown;
    capacity = larger;
  }
  /// Holds as many elements as another one from now on, and the same.
  [[gnu::noinline]] void copy(const TableMemory& other, std::size_t element) {
    if (other.size > capacity) grow(other.size, element);
    size = other.size;
    if (size > 0) std::memcpy(data, other.data, static_cast<std::size_t>(size) * element);
  }
};

/// A vector counted in signed numbers, as the sparse algorithms count their columns and blocks. Its elements are plain
/// data, so that it costs next to nothing to compile for another type.
template <class T>
class Table {
  static_assert(std::is_trivially_copyable_v<T> && std::is_trivially_destructible_v<T>);
  static_assert(alignof(T) <= alignof(std::max_align_t));

 public:
  using value_type = T;

  Table() = default;
  explicit Table(Offset size, T value = T{}) { assign(size, value); }
  explicit Table(std::span<const T> values) { append(values); }
  Table(const Table& other) { memory_.copy(other.memory_, sizeof(T)); }
  Table(Table&& other) noexcept : memory_(std::exchange(other.memory_, {})) {}
  Table& operator=(const Table& other) {
    if (this != &other) memory_.copy(other.memory_, sizeof(T));
    return *this;
  }
  Table& operator=(Table&& other) noexcept {
    std::swap(memory_, other.memory_);
    other.clear();
    return *this;
  }
  ~Table() { std::free(memory_.data); }

  [[nodiscard]] T& operator[](Offset i) {
    assert(i >= 0 && i < size());
    return data()[i];
  }
  [[nodiscard]] const T& operator[](Offset i) const {
    assert(i >= 0 && i < size());
    return data()[i];
  }

  [[nodiscard]] Offset size() const { return memory_.size; }
  [[nodiscard]] bool empty() const { return memory_.size == 0; }
  [[nodiscard]] T* data() { return static_cast<T*>(memory_.data); }
  [[nodiscard]] const T* data() const { return static_cast<const T*>(memory_.data); }
  [[nodiscard]] T& back() { return (*this)[size() - 1]; }

  void assign(Offset size, T value) {
    clear();
    resize(size, value);
  }
  [[gnu::noinline]] void resize(Offset size, T value = T{}) {
    reserve(size);
    for (Offset k = memory_.size; k < size; ++k) data()[k] = value;
    memory_.size = size;
  }
  void reserve(Offset capacity) {
    if (capacity > memory_.capacity) memory_.grow(capacity, sizeof(T));
  }
  void push_back(T value) {
    reserve(size() + 1);
    data()[memory_.size++] = value;
  }
  /// @param values  not of this table.
  [[gnu::noinline]] void append(std::span<const T> values) {
    reserve(size() + static_cast<Offset>(values.size()));
    if (!values.empty()) std::memcpy(end(), values.data(), values.size_bytes());
    memory_.size += static_cast<Offset>(values.size());
  }
  void pop_back() {
    assert(!empty());
    --memory_.size;
  }
  void clear() { memory_.size = 0; }

  [[nodiscard]] std::span<const T> range(Offset begin, Offset end) const {
    return {data() + begin, static_cast<std::size_t>(end - begin)};
  }
  [[nodiscard]] std::span<T> range(Offset begin, Offset end) {
    return {data() + begin, static_cast<std::size_t>(end - begin)};
  }
  [[nodiscard]] std::span<const T> all() const { return range(0, size()); }

  [[nodiscard]] T* begin() { return data(); }
  [[nodiscard]] T* end() { return data() + size(); }
  [[nodiscard]] const T* begin() const { return data(); }
  [[nodiscard]] const T* end() const { return data() + size(); }

 private:
  TableMemory memory_;
};

}  // namespace chainslam::detail
