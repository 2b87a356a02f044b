#pragma once

#include "chainslam/core/finite.hpp"

namespace chainslam::detail {
using chainslam::is_finite;
}  // namespace chainslam::detail
