#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

namespace chainslam::detail {

/// The kinds of number that point files hold.
enum class ScalarType : std::uint8_t { int8, uint8, int16, uint16, int32, uint32, int64, uint64, float32, float64 };

[[nodiscard]] constexpr std::size_t size_of(ScalarType type) {
  constexpr std::array<std::size_t, 10> sizes{1, 1, 2, 2, 4, 4, 8, 8, 4, 8};
  return sizes[static_cast<std::size_t>(type)];
}

[[nodiscard]] constexpr bool is_integer(ScalarType type) { return type < ScalarType::float32; }

/// Loads a number stored in the given byte order; `data` needs no alignment.
template <class T>
[[nodiscard]] T load(const std::byte* data, std::endian order = std::endian::little) {
  std::array<std::byte, sizeof(T)> bytes;
  for (std::size_t i = 0; i < sizeof(T); ++i) bytes[i] = data[order == std::endian::native ? i : sizeof(T) - 1 - i];
  return std::bit_cast<T>(bytes);
}

/// Appends a number, least significant byte first.
template <class T>
void store(std::vector<std::byte>& out, T value) {
  const auto bytes = std::bit_cast<std::array<std::byte, sizeof(T)>>(value);
  for (std::size_t i = 0; i < sizeof(T); ++i)
    out.push_back(bytes[std::endian::native == std::endian::little ? i : sizeof(T) - 1 - i]);
}

/// Loads any of the kinds as a double (64-bit integers beyond 2^53 are rounded).
[[nodiscard]] inline double load_as_double(ScalarType type, const std::byte* data,
                                           std::endian order = std::endian::little) {
  switch (type) {
    case ScalarType::int8:
      return static_cast<double>(load<std::int8_t>(data, order));
    case ScalarType::uint8:
      return static_cast<double>(load<std::uint8_t>(data, order));
    case ScalarType::int16:
      return static_cast<double>(load<std::int16_t>(data, order));
    case ScalarType::uint16:
      return static_cast<double>(load<std::uint16_t>(data, order));
    case ScalarType::int32:
      return static_cast<double>(load<std::int32_t>(data, order));
    case ScalarType::uint32:
      return static_cast<double>(load<std::uint32_t>(data, order));
    case ScalarType::int64:
      return static_cast<double>(load<std::int64_t>(data, order));
    case ScalarType::uint64:
      return static_cast<double>(load<std::uint64_t>(data, order));
    case ScalarType::float32:
      return static_cast<double>(load<float>(data, order));
    case ScalarType::float64:
      break;
  }
  return load<double>(data, order);
}

/// A double as float: beyond float's range it is infinite, as reading it as a float would have given.
[[nodiscard]] inline float to_float(double value) {
  if (value > std::numeric_limits<float>::max()) return std::numeric_limits<float>::infinity();
  if (value < std::numeric_limits<float>::lowest()) return -std::numeric_limits<float>::infinity();
  return static_cast<float>(value);
}

}  // namespace chainslam::detail
