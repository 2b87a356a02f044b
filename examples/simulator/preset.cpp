#include "simulator/preset.hpp"

#include <array>
#include <utility>

#include "simulator/hard_presets.hpp"
#include "simulator/large_presets.hpp"

namespace chainslam::simulator {

namespace {

Preset town() {
  Preset preset =
      preset_named("town", "a drive through a hilly town, several loops in the same and in opposite directions");
  // Once around, then a smaller loop that shares streets with the first, in the same and in the opposite direction.
  const Route route = {{1, 1}, {2, 1}, {3, 1}, {4, 1}, {4, 2}, {4, 3}, {3, 3}, {2, 3}, {1, 3},
                       {1, 2}, {1, 1}, {2, 1}, {2, 2}, {3, 2}, {3, 1}, {2, 1}, {1, 1}};
  preset.sessions = {{.route = route}};
  // A sensor that sees 25 m and is badly calibrated: odometry alone ends more than a metre off.
  preset.lidar.firings_per_revolution = 480;
  preset.lidar.max_range = 25.0;
  preset.lidar.elevation_error_deg = 0.2;
  preset.lidar.range_bias = 0.03;
  preset.lidar.mount_angle_deg = 0.5;
  return preset;
}

Preset town_small() {
  Preset preset = town();
  preset.name = "town-small";
  preset.summary = "once around a block of a small town";
  preset.town.streets = {.columns = 4, .rows = 4, .block = 34.0, .irregularity = 0.1, .jitter = 2.0};
  preset.town.border = 15.0;
  preset.sessions = {{.route = {{1, 1}, {2, 1}, {2, 2}, {1, 2}, {1, 1}, {2, 1}}}};
  preset.drive.stop_at = -1.0;
  return preset;
}

Preset town_sessions() {
  Preset preset = town();
  preset.name = "town-sessions";
  preset.summary = "three drives through a hilly town on three days, from different starts, over streets they share";
  // Once around two by two blocks.
  const Route around = {{1, 2}, {1, 1}, {2, 1}, {3, 1}, {3, 2}, {3, 3}, {2, 3}, {1, 3}, {1, 2}, {1, 1}, {2, 1}};
  // In through the middle, then around the northern blocks against the first.
  const Route against = {{4, 2}, {3, 2}, {2, 2}, {1, 2}, {1, 3}, {2, 3}, {3, 3}, {3, 2}, {2, 2}, {1, 2}};
  // In from the south, then around the eastern blocks with the first, and out to the east.
  const Route along = {{2, 0}, {2, 1}, {3, 1}, {3, 2}, {3, 3}, {2, 3}, {2, 2}, {2, 1}, {3, 1}, {4, 1}};
  preset.sessions = {{.route = around, .day = 0}, {.route = against, .day = 21}, {.route = along, .day = 63}};
  return preset;
}

}  // namespace

Preset preset_named(std::string name, std::string summary) {
  return {.name = std::move(name),
          .summary = std::move(summary),
          .town = {},
          .drive = {},
          .lidar = {},
          .imu = {},
          .gnss = {},
          .traffic = {},
          .sessions = {}};
}

std::span<const std::string_view> preset_names() {
  static constexpr std::array<std::string_view, 7> names{"town",      "town-small", "town-sessions", "nclt-like",
                                                         "mars-like", "nclt-hard",  "mars-hard"};
  return names;
}

std::optional<PresetSize> preset_size(std::string_view name) {
  if (name == "small") return PresetSize::small;
  if (name == "medium") return PresetSize::medium;
  if (name == "large") return PresetSize::large;
  if (name == "full") return PresetSize::full;
  return std::nullopt;
}

std::optional<Preset> preset(std::string_view name, PresetSize size) {
  if (name == "town") return town();
  if (name == "town-small") return town_small();
  if (name == "town-sessions") return town_sessions();
  if (name == "nclt-like") return nclt_like(size);
  if (name == "mars-like") return mars_like(size);
  if (name == "nclt-hard") return nclt_hard(size);
  if (name == "mars-hard") return mars_hard(size);
  return std::nullopt;
}

}  // namespace chainslam::simulator
