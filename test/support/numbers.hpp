#pragma once

#include <limits>
#include <numbers>

namespace chainslam::test {

inline constexpr double degree = std::numbers::pi / 180;
inline constexpr double nan = std::numeric_limits<double>::quiet_NaN();

}  // namespace chainslam::test
