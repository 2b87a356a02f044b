#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>

namespace chainslam::detail {

// Vectors of the compiler's own, as wide as its registers: plain arithmetic on them is SIMD at any level of
// optimization, on any processor. They go by reference, since how they are passed by value depends on flags.

#if defined(__AVX__)
inline constexpr std::size_t lane_count = 8;
#else
inline constexpr std::size_t lane_count = 4;
#endif

using FloatLanes = float __attribute__((vector_size(lane_count * sizeof(float))));
using MaskLanes =
    std::int32_t __attribute__((vector_size(lane_count * sizeof(std::int32_t))));  ///< -1 for true, 0 for false

/// The least multiple of `lane_count` that is not below `count`.
[[nodiscard]] constexpr std::size_t whole_lanes(std::size_t count) {
  return (count + lane_count - 1) / lane_count * lane_count;
}

inline void load(const float* from, FloatLanes& to) { std::memcpy(&to, from, sizeof to); }
inline void store(const FloatLanes& from, float* to) { std::memcpy(to, &from, sizeof from); }

/// `to` becomes `yes` where the mask is true and `no` elsewhere.
inline void choose(const MaskLanes& mask, const FloatLanes& yes, const FloatLanes& no, FloatLanes& to) {
  MaskLanes yes_bits, no_bits;
  std::memcpy(&yes_bits, &yes, sizeof yes_bits);
  std::memcpy(&no_bits, &no, sizeof no_bits);
  const MaskLanes bits = (mask & yes_bits) | (~mask & no_bits);
  std::memcpy(&to, &bits, sizeof to);
}

/// `to` becomes -x where the mask is true.
inline void negate_where(const MaskLanes& mask, const FloatLanes& x, FloatLanes& to) {
  MaskLanes bits;
  std::memcpy(&bits, &x, sizeof bits);
  bits ^= mask & INT32_MIN;
  std::memcpy(&to, &bits, sizeof to);
}

/// 1 / sqrt(x) to the last bits of float, for positive normal x: Newton's method from the well-known guess by the
/// exponent. 0 gives something finite.
inline void inverse_root(const FloatLanes& x, FloatLanes& to) {
  MaskLanes bits;
  std::memcpy(&bits, &x, sizeof bits);
  bits = 0x5f375a86 - (bits >> 1);
  FloatLanes y;
  std::memcpy(&y, &bits, sizeof y);
  const FloatLanes half = x * 0.5F;
  for (int step = 0; step < 3; ++step) y = y * (1.5F - half * y * y);
  to = y;
}

[[nodiscard]] inline std::int32_t sum(const MaskLanes& values) {
  std::int32_t total = 0;
  for (std::size_t lane = 0; lane < lane_count; ++lane) total += values[lane];
  return total;
}

/// Whether the mask is true anywhere.
[[nodiscard]] inline bool any(const MaskLanes& mask) {
  std::uint64_t bits = 0;
  for (std::size_t lane = 0; lane < lane_count; lane += 2) {
    std::uint64_t two;
    std::memcpy(&two, reinterpret_cast<const char*>(&mask) + lane * sizeof(std::int32_t), sizeof two);
    bits |= two;
  }
  return bits != 0;
}

}  // namespace chainslam::detail
