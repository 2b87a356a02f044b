#pragma once

#include <cassert>
#include <cstddef>
#include <span>

#include "chainslam/core/byte_archive.hpp"

namespace chainslam::detail {

/// Takes little-endian numbers off a record whose length has been checked.
class ByteReader {
 public:
  explicit ByteReader(std::span<const std::byte> bytes) : bytes_(bytes) {}

  template <class T>
  [[nodiscard]] T take() {
    return load_as<T>(take(sizeof(T)).data());
  }
  [[nodiscard]] std::span<const std::byte> take(std::size_t count) {
    assert(count <= bytes_.size());
    const auto taken = bytes_.first(count);
    bytes_ = bytes_.subspan(count);
    return taken;
  }
  [[nodiscard]] std::size_t left() const { return bytes_.size(); }

 private:
  std::span<const std::byte> bytes_;
};

}  // namespace chainslam::detail
