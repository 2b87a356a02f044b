#pragma once

#include <numbers>

namespace chainslam::simulator {

inline constexpr double degree = std::numbers::pi / 180.0;  ///< radians

}  // namespace chainslam::simulator
