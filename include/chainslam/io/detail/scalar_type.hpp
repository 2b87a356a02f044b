#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <limits>

#include "chainslam/core/byte_archive.hpp"

namespace chainslam::detail {

/// The kinds of number that point files hold.
enum class ScalarType : std::uint8_t { int8, uint8, int16, uint16, int32, uint32, int64, uint64, float32, float64 };

[[nodiscard]] constexpr std::size_t size_of(ScalarType type) {
  constexpr std::array<std::size_t, 10> sizes{1, 1, 2, 2, 4, 4, 8, 8, 4, 8};
  return sizes[static_cast<std::size_t>(type)];
}

[[nodiscard]] constexpr bool is_integer(ScalarType type) { return type < ScalarType::float32; }

/// Loads any of the kinds as a double (64-bit integers beyond 2^53 are rounded).
[[nodiscard]] inline double load_as_double(ScalarType type, const std::byte* data,
                                           std::endian order = std::endian::little) {
  switch (type) {
    case ScalarType::int8:
      return static_cast<double>(load_as<std::int8_t>(data, order));
    case ScalarType::uint8:
      return static_cast<double>(load_as<std::uint8_t>(data, order));
    case ScalarType::int16:
      return static_cast<double>(load_as<std::int16_t>(data, order));
    case ScalarType::uint16:
      return static_cast<double>(load_as<std::uint16_t>(data, order));
    case ScalarType::int32:
      return static_cast<double>(load_as<std::int32_t>(data, order));
    case ScalarType::uint32:
      return static_cast<double>(load_as<std::uint32_t>(data, order));
    case ScalarType::int64:
      return static_cast<double>(load_as<std::int64_t>(data, order));
    case ScalarType::uint64:
      return static_cast<double>(load_as<std::uint64_t>(data, order));
    case ScalarType::float32:
      return static_cast<double>(load_as<float>(data, order));
    case ScalarType::float64:
      break;
  }
  return load_as<double>(data, order);
}

/// A double as float: beyond float's range it is infinite, as reading it as a float would have given.
[[nodiscard]] inline float to_float(double value) {
  if (value > std::numeric_limits<float>::max()) return std::numeric_limits<float>::infinity();
  if (value < std::numeric_limits<float>::lowest()) return -std::numeric_limits<float>::infinity();
  return static_cast<float>(value);
}

}  // namespace chainslam::detail
