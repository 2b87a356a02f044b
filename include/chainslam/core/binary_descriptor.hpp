#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

#include "chainslam/core/types.hpp"

namespace chainslam {

/// 256 answers of yes or no about a place; similar places differ in few.
using BinaryDescriptor = std::array<std::uint64_t, 4>;

namespace detail {

/// Number of ones. Without an instruction for it, `std::popcount` calls a function that looks bytes up.
[[nodiscard]] inline int count_ones(std::uint64_t bits) {
#ifdef __POPCNT__
  return std::popcount(bits);
#else
  bits -= (bits >> 1U) & 0x5555555555555555U;
  bits = (bits & 0x3333333333333333U) + ((bits >> 2U) & 0x3333333333333333U);
  return static_cast<int>((((bits + (bits >> 4U)) & 0x0f0f0f0f0f0f0f0fU) * 0x0101010101010101U) >> 56U);
#endif
}

}  // namespace detail

/// Number of bits that differ.
[[nodiscard]] inline Index hamming_distance(const BinaryDescriptor& a, const BinaryDescriptor& b) {
  int count = 0;
  for (std::size_t word = 0; word < a.size(); ++word) count += detail::count_ones(a[word] ^ b[word]);
  return count;
}

/// The same, but without looking at all words where the first one makes it more than `limit` almost surely: it differs
/// in so many bits more than its share that of random differences one in a thousand would.
/// @returns the distance, or more than `limit`.
[[nodiscard]] inline Index hamming_distance_within(const BinaryDescriptor& a, const BinaryDescriptor& b, Index limit) {
  const Index first = detail::count_ones(a[0] ^ b[0]);
  if (first > limit / 4 + 10) return limit + 1;
  return first + detail::count_ones(a[1] ^ b[1]) + detail::count_ones(a[2] ^ b[2]) + detail::count_ones(a[3] ^ b[3]);
}

}  // namespace chainslam
