#pragma once

#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "simulator/drive.hpp"
#include "simulator/gnss_receiver.hpp"
#include "simulator/inertial_unit.hpp"
#include "simulator/spinning_lidar.hpp"
#include "simulator/town.hpp"

namespace chainslam::simulator {

/// What differs between the sessions of one vehicle in one town.
struct SessionPlan {
  Route route;
  Index day = 0;  ///< since 2013-06-01; parked cars, GNSS and inertial biases and all noise are the day's
};

/// Everything that simulated sessions are made from, but for the seed.
struct Preset {
  std::string name;
  std::string summary;  ///< one sentence
  TownOptions town;
  DriveOptions drive;
  LidarOptions lidar;
  InertialOptions imu;
  GnssOptions gnss;
  std::vector<SessionPlan> sessions;
};

/// The names that `preset` knows.
[[nodiscard]] std::span<const std::string_view> preset_names();

/// "town": a drive of about 880 m and 125 s through two loops that share streets. "town-small": once around a block,
/// about 25 s. "town-sessions": the same town on three days, each drive of 350 to 600 m with a loop of its own, from
/// another start; the second shares half of its streets with the first and has them on the other lane, the third two
/// thirds, on the same lane.
/// @returns nothing for a name it does not know.
[[nodiscard]] std::optional<Preset> preset(std::string_view name);

}  // namespace chainslam::simulator
