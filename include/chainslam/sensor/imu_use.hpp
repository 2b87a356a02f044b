#pragma once

#include <cstdint>

namespace chainslam {

/// What of an IMU's measurements an estimate relies on, from most to least. The numbers are those of map files.
enum class ImuUse : std::uint8_t {
  all = 0,
  gyroscope = 1,        ///< the scans contradicted the accelerometer
  rough_gyroscope = 2,  ///< the scans contradicted the gyroscope, too: it only undistorts
  none = 3,             ///< not used, or there are no measurements
};

}  // namespace chainslam
