#pragma once

#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "simulator/drive.hpp"
#include "simulator/gnss_receiver.hpp"
#include "simulator/inertial_unit.hpp"
#include "simulator/spinning_lidar.hpp"
#include "simulator/town.hpp"

namespace chainslam::simulator {

/// Everything that a simulated session is made from, but for the seed.
struct Preset {
  std::string name;
  std::string summary;  ///< one sentence
  TownOptions town;
  DriveOptions drive;
  LidarOptions lidar;
  InertialOptions imu;
  GnssOptions gnss;
};

/// The names that `preset` knows.
[[nodiscard]] std::span<const std::string_view> preset_names();

/// "town": a drive of about 880 m and 125 s through two loops that share streets. "town-small": once around a block,
/// about 25 s.
/// @returns nothing for a name it does not know.
[[nodiscard]] std::optional<Preset> preset(std::string_view name);

}  // namespace chainslam::simulator
