#pragma once

#include "simulator/preset.hpp"

namespace chainslam::test {

/// Drives at 12 m/s and with 3 m/s^2 whichever way: the sooner it is over.
inline void hurry(simulator::Preset& preset) {
  preset.drive.cruise = 12.0;
  preset.drive.acceleration = preset.drive.braking = preset.drive.lateral_acceleration = 3.0;
}

}  // namespace chainslam::test
