#pragma once

#include <array>
#include <bit>
#include <cstddef>
#include <cstdint>

#include "chainslam/core/types.hpp"

namespace chainslam {

/// 256 answers of yes or no about a place; similar places differ in few.
using BinaryDescriptor = std::array<std::uint64_t, 4>;

/// Number of bits that differ.
[[nodiscard]] inline Index hamming_distance(const BinaryDescriptor& a, const BinaryDescriptor& b) {
  int count = 0;
  for (std::size_t word = 0; word < a.size(); ++word) count += std::popcount(a[word] ^ b[word]);
  return count;
}

/// The same, but without looking at all words where the first one makes it more than `limit` almost surely: it differs
/// in so many bits more than its share that of random differences one in a thousand would.
/// @returns the distance, or more than `limit`.
[[nodiscard]] inline Index hamming_distance_within(const BinaryDescriptor& a, const BinaryDescriptor& b, Index limit) {
  const Index first = std::popcount(a[0] ^ b[0]);
  if (first > limit / 4 + 10) return limit + 1;
  return first + std::popcount(a[1] ^ b[1]) + std::popcount(a[2] ^ b[2]) + std::popcount(a[3] ^ b[3]);
}

}  // namespace chainslam
