#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "chainslam/core/timestamp.hpp"
#include "chainslam/core/types.hpp"

namespace chainslam::simulator {

/// The makes of spinning LiDAR that are known.
enum class LidarKind : std::uint8_t { hdl_32e, vlp_16, os1_64, vls_128, hdl_64e };

/// One laser, as the data sheet has it.
struct LidarChannel {
  double elevation_deg;
  double azimuth_deg;  ///< where it points beside the sensor's own azimuth, positive to the left
  Duration delay;      ///< from the firing's first laser
  std::uint8_t ring;   ///< its place from the lowest, from 0
};

/// What a data sheet says of a spinning LiDAR at ten revolutions a second.
struct LidarModel {
  std::string_view name;
  std::vector<LidarChannel> channels;  ///< in the order of firing
  Index firings_per_revolution;        ///< at full rate
  Index firings_per_packet;
  double range_of_tenth;  ///< a diffuse surface that reflects a tenth is seen half the time from here, metres
};

/// The table of a make. Sources: HDL-32E user's manual 63-9113 (firing order, 1.152 us a laser, 46.08 us a firing);
/// VLP-16 user manual 63-9243 (2.304 us, 55.296 us); Ouster's design values for the first OS1-64 (1024 columns, all
/// pixels of a column at once, four offsets in azimuth); VLS-128 user manual 63-9483 (groups of eight at 2.665 us with
/// one slot of rest after the eighth, 53.3 us a firing, elevations and eight offsets in azimuth); HDL-64E S2 user's
/// manual 63-HDL64ES2 (two blocks of 32 lasers, 1/3 and 1/2 degree apart, 48 us a firing; lasers evenly spaced in time
/// here).
[[nodiscard]] const LidarModel& lidar_model(LidarKind kind);

/// The make of a name such as "HDL-64E" or "hdl-64e", or nothing.
[[nodiscard]] std::optional<LidarKind> lidar_kind(std::string_view name);

/// The names of all makes, as a list for people.
[[nodiscard]] std::string lidar_names();

}  // namespace chainslam::simulator
