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
#include "simulator/traffic.hpp"

namespace chainslam::simulator {

/// What differs between the sessions of one vehicle in one town.
struct SessionPlan {
  Route route;
  Index day = 0;  ///< since 2013-06-01; parked cars, GNSS and inertial biases and all noise are the day's
};

/// Whose file layout sessions are written in.
enum class FileLayout { nclt, nuscenes };

/// Everything that simulated sessions are made from, but for the seed.
struct Preset {
  std::string name;
  std::string summary;  ///< one sentence
  TownOptions town;
  DriveOptions drive;
  LidarOptions lidar;
  InertialOptions imu;
  GnssOptions gnss;
  TrafficOptions traffic;
  std::vector<SessionPlan> sessions;
  FileLayout layout = FileLayout::nclt;
  bool labelled = false;  ///< NCLT: writes for every hit whether it lasts, changes or moves
};

/// A preset of which all else is what the options are by themselves, without sessions.
[[nodiscard]] Preset preset_named(std::string name, std::string summary);

/// The names that `preset` knows.
[[nodiscard]] std::span<const std::string_view> preset_names();

/// How long sessions are; see `preset`.
enum class PresetSize { small, medium, large, full };

/// The size of a name, or nothing.
[[nodiscard]] std::optional<PresetSize> preset_size(std::string_view name);

/// "town": a drive of about 880 m and 125 s through two loops that share streets. "town-small": once around a block,
/// about 25 s. "town-sessions": the same town on three days, each drive of 350 to 600 m with a loop of its own, from
/// another start; the second shares half of its streets with the first and has them on the other lane, the third two
/// thirds, on the same lane.
/// These three have one size.
///
/// "nclt-like": five sessions of a segway on a campus, HDL-32E at 10 Hz and inertial unit at 100 Hz: large buildings
/// and lawns, people, a corridor indoors where GNSS is lost; in winter bare trees and snow. Small: three blocks, about
/// 100 s each; medium: 15 min; large: 5 km; full: 90 min over 400 x 800 m. "mars-like": five sessions of a car in a
/// town of avenues, VLS-128 at 10 Hz and inertial unit at 10 Hz: a tunnel, traffic alongside and against it. Small: 900
/// m, about 90 s each; medium and large: 6 km, 10 min; full: over 1500 x 3000 m, 2.4 h.
///
/// "nclt-hard", "mars-hard": the same with harder errors and places (see `error_sources`; bench/results.md has how far
/// FAST-LIO2 as published drifts in them). Small and full: as above; medium: 1.5 and 3 km a session; large: 5 and 6 km.
///
/// All four have the errors of real sensors (see the options) and are told only nominal values. Their sessions start
/// apart, in mixed directions, and share a half to four fifths of their streets with those before.
/// @returns nothing for a name it does not know.
[[nodiscard]] std::optional<Preset> preset(std::string_view name, PresetSize size = PresetSize::medium);

}  // namespace chainslam::simulator
