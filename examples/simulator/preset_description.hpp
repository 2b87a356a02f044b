#pragma once

#include <string>

#include "simulator/preset.hpp"

namespace chainslam::simulator {

/// Every option of a preset, a line each, such as "lidar.range_noise = 0.02": equal texts make equal data.
[[nodiscard]] std::string describe_options(const Preset& preset);

/// The hash of that text, 16 hexadecimal digits: by it a table says which world it is from.
[[nodiscard]] std::string options_hash(const Preset& preset);

}  // namespace chainslam::simulator
