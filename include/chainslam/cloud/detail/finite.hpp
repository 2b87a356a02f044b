#pragma once

#include <Eigen/Core>
#include <bit>
#include <cstdint>

namespace chainslam::detail {

/// Neither NaN nor infinite; looks at the exponent's bits, so that it holds under -ffast-math too.
[[nodiscard]] inline bool is_finite(float value) {
  constexpr std::uint32_t exponent = 0x7f80'0000U;
  return (std::bit_cast<std::uint32_t>(value) & exponent) != exponent;
}

[[nodiscard]] inline bool is_finite(double value) {
  constexpr std::uint64_t exponent = 0x7ff0'0000'0000'0000U;
  return (std::bit_cast<std::uint64_t>(value) & exponent) != exponent;
}

template <class Scalar>
[[nodiscard]] bool is_finite(const Eigen::Matrix<Scalar, 3, 1>& p) {
  return is_finite(p[0]) && is_finite(p[1]) && is_finite(p[2]);
}

}  // namespace chainslam::detail
