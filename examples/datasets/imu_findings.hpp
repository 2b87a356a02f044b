#pragma once

#include <string>
#include <vector>

#include "chainslam/sensor/imu_check.hpp"

namespace chainslam::datasets {

/// What a check of an IMU's samples found, a sentence for each kind with its count; empty if nothing is wrong.
[[nodiscard]] std::vector<std::string> imu_findings(const ImuCheckCounts& counts);

}  // namespace chainslam::datasets
