#include "simulator/preset.hpp"

#include <array>

namespace chainslam::simulator {

namespace {

Preset town() {
  Preset preset{.name = "town",
                .summary = "a drive through a hilly town, several loops in the same and in opposite directions",
                .town = {},
                .drive = {},
                .lidar = {},
                .imu = {},
                .gnss = {}};
  // Three loops that share streets: the second and the last pass the first one's start in the same direction, the way
  // down from (2, 3) meets the way up on the other lane.
  preset.drive.route = {{1, 2}, {2, 2}, {2, 3}, {1, 3}, {1, 2}, {2, 2}, {3, 2},
                        {3, 3}, {2, 3}, {2, 2}, {2, 1}, {1, 1}, {1, 2}, {2, 2}};
  return preset;
}

Preset town_small() {
  Preset preset = town();
  preset.name = "town-small";
  preset.summary = "once around a block of a small town";
  preset.town.streets = {.columns = 4, .rows = 4, .block = 34.0, .irregularity = 0.1, .jitter = 2.0};
  preset.town.border = 15.0;
  preset.drive.route = {{1, 1}, {2, 1}, {2, 2}, {1, 2}, {1, 1}, {2, 1}};
  preset.drive.stop_at = -1.0;
  return preset;
}

}  // namespace

std::span<const std::string_view> preset_names() {
  static constexpr std::array<std::string_view, 2> names{"town", "town-small"};
  return names;
}

std::optional<Preset> preset(std::string_view name) {
  if (name == "town") return town();
  if (name == "town-small") return town_small();
  return std::nullopt;
}

}  // namespace chainslam::simulator
