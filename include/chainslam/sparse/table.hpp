#pragma once

#include <cassert>
#include <cstddef>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

namespace chainslam {

/// Position in a list that may outgrow `Index`: blocks of a matrix, coefficients of a factor.
using Offset = std::int64_t;

}  // namespace chainslam

namespace chainslam::detail {

/// A vector counted in signed numbers, as the sparse algorithms count their columns and blocks.
template <class T>
class Table {
 public:
  Table() = default;
  explicit Table(Offset size, const T& value = T{}) : values_(static_cast<std::size_t>(size), value) {}
  explicit Table(std::vector<T> values) : values_(std::move(values)) {}

  [[nodiscard]] T& operator[](Offset i) {
    assert(i >= 0 && i < size());
    return values_[static_cast<std::size_t>(i)];
  }
  [[nodiscard]] const T& operator[](Offset i) const {
    assert(i >= 0 && i < size());
    return values_[static_cast<std::size_t>(i)];
  }

  [[nodiscard]] Offset size() const { return static_cast<Offset>(values_.size()); }
  [[nodiscard]] T* data() { return values_.data(); }
  [[nodiscard]] const T* data() const { return values_.data(); }
  void assign(Offset size, const T& value) { values_.assign(static_cast<std::size_t>(size), value); }
  void resize(Offset size) { values_.resize(static_cast<std::size_t>(size)); }
  void reserve(Offset size) { values_.reserve(static_cast<std::size_t>(size)); }
  void push_back(const T& value) { values_.push_back(value); }
  void append(std::span<const T> values) { values_.insert(values_.end(), values.begin(), values.end()); }
  void pop_back() { values_.pop_back(); }
  void clear() { values_.clear(); }
  [[nodiscard]] T& back() { return values_.back(); }
  [[nodiscard]] std::span<const T> range(Offset begin, Offset end) const {
    return {values_.data() + begin, static_cast<std::size_t>(end - begin)};
  }
  [[nodiscard]] std::span<T> range(Offset begin, Offset end) {
    return {values_.data() + begin, static_cast<std::size_t>(end - begin)};
  }
  [[nodiscard]] const std::vector<T>& vector() const& { return values_; }
  [[nodiscard]] std::vector<T> vector() && { return std::move(values_); }

  [[nodiscard]] auto begin() { return values_.begin(); }
  [[nodiscard]] auto end() { return values_.end(); }
  [[nodiscard]] auto begin() const { return values_.begin(); }
  [[nodiscard]] auto end() const { return values_.end(); }

 private:
  std::vector<T> values_;
};

}  // namespace chainslam::detail
