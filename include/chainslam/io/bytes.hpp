#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <vector>

namespace chainslam {

/// Loads a number stored in the given byte order; `data` needs no alignment.
template <class T>
[[nodiscard]] T load_as(const std::byte* data, std::endian order = std::endian::little) {
  std::array<std::byte, sizeof(T)> bytes;
  for (std::size_t i = 0; i < sizeof(T); ++i) bytes[i] = data[order == std::endian::native ? i : sizeof(T) - 1 - i];
  return std::bit_cast<T>(bytes);
}

/// Appends a number, least significant byte first.
template <class T>
void append_bytes(std::vector<std::byte>& out, T value) {
  const auto bytes = std::bit_cast<std::array<std::byte, sizeof(T)>>(value);
  for (std::size_t i = 0; i < sizeof(T); ++i)
    out.push_back(bytes[std::endian::native == std::endian::little ? i : sizeof(T) - 1 - i]);
}

}  // namespace chainslam
