#include "simulator/large_presets.hpp"

#include <array>
#include <string>
#include <utility>

#include "simulator/rig.hpp"
#include "simulator/wander.hpp"

namespace chainslam::simulator {

namespace {

constexpr std::array<Index, 5> days{0, 40, 170, 220, 330};  // the third and fourth are in winter

}  // namespace

std::vector<SessionPlan> walks(Index columns, Index rows, Index streets) {
  const Index wide = columns - 1 - columns / 4;
  const Index high = rows - 1 - rows / 4;
  const std::array<Window, 5> windows{{{{0, 0}, {wide, rows - 1}},
                                       {{columns - 1 - wide, 0}, {columns - 1, rows - 1}},
                                       {{0, 0}, {columns - 1, high}},
                                       {{0, rows - 1 - high}, {columns - 1, rows - 1}},
                                       {{columns / 4, rows / 4}, {columns - 1, rows - 1}}}};
  std::vector<SessionPlan> sessions;
  for (std::size_t i = 0; i < windows.size(); ++i)
    sessions.push_back({.route = wander(windows[i], streets, Rng(2013).fork(i)), .day = days[i]});
  return sessions;
}

namespace {

std::vector<SessionPlan> on_their_days(const std::array<Route, 5>& routes) {
  std::vector<SessionPlan> sessions;
  for (std::size_t i = 0; i < routes.size(); ++i) sessions.push_back({.route = routes[i], .day = days[i]});
  return sessions;
}

/// What real sensors have on top of white noise; both presets.
void add_errors(Preset& preset) {
  preset.lidar.range_noise = 0.02;
  preset.lidar.elevation_error_deg = 0.1;
  preset.lidar.range_bias = 0.02;
  preset.lidar.incidence_bias = 0.004;
  preset.lidar.mount_angle_deg = 0.3;
  preset.lidar.mount_shift = 0.02;
  preset.lidar.lost_returns = 0.01;
  preset.lidar.beam_width_deg = 0.16;
  preset.lidar.clock_offset = 0.002;
  preset.imu.g_sensitivity = 1e-4;
  preset.gnss.wander = 3.0;
  preset.gnss.wander_time = 150.0;
  preset.gnss.time_between_outages = 240.0;
  preset.gnss.outage_duration = 10.0;
  preset.gnss.time_between_bursts = 60.0;
  preset.gnss.flat_fixes = 0.05;
  preset.gnss.latency = 0.1;
  preset.gnss.needs_sky = true;
  preset.town.seasons = true;
  preset.labelled = true;
}

void ride_a_segway(DriveOptions& drive) {
  drive.lane = 2.2;
  drive.cruise = 1.3;
  drive.lateral_acceleration = 0.8;
  drive.acceleration = 0.5;
  drive.braking = 0.6;
  drive.stop_at = -1.0;
  drive.body_height = 1.15;
  drive.vibration_speed = 1.0;
  drive.vibration_height = 1e-3;
  drive.vibration_angle = 2e-3;
  drive.dive = -0.08;  // it leans into the acceleration
  drive.lean = 0.0;
  drive.sway_angle = 0.02;
  drive.corners = {.left = 3.5, .right = 2.0, .bend = 15.0};
}

void drive_a_car(DriveOptions& drive) {
  drive.lane = 5.0;
  drive.cruise = 12.0;
  drive.stop_at = -1.0;
  drive.body_height = nominal_T_ego_imu().translation().z();
}

}  // namespace

Preset nclt_like(PresetSize size) {
  Preset preset =
      preset_named("nclt-like", "a segway on a campus in five sessions over a year, outdoors and through a corridor");
  add_errors(preset);
  ride_a_segway(preset.drive);
  preset.drive.between_stops = 120.0;
  TownOptions& campus = preset.town;
  campus.streets = {
      .columns = 4, .rows = 4, .block = 70.0, .irregularity = 0.15, .jitter = 5.0, .half_road = 5.0, .pavement = 1.5};
  campus.steepness = 0.02;
  campus.parked = 0.12;
  campus.houses = {.least_width = 16.0,
                   .most_width = 40.0,
                   .least_depth = 12.0,
                   .most_depth = 22.0,
                   .at_the_street = 0.2,
                   .most_setback = 9.0};
  campus.built = 0.75;
  campus.open_sides = 0.3;
  campus.alike = 0.25;
  campus.scaffolds = 0.1;
  campus.built_later = 0.05;
  campus.area_per_tree = 60.0;
  preset.traffic = {.between_people = 5.0, .lane = preset.drive.lane, .least_aside = 4.9, .most_aside = 6.4};
  preset.lidar.firings_per_revolution = 540;
  switch (size) {
    case PresetSize::small:
      campus.streets.columns = campus.streets.rows = 3;
      campus.streets.block = 45.0;
      campus.streets.jitter = 2.0;
      campus.houses.most_width = 24.0;
      campus.houses.most_depth = 14.0;
      campus.houses.most_setback = 4.0;
      campus.passages = {{.from = {1, 1}, .to = {2, 1}, .kind = PassageKind::corridor, .begin = 0.25, .end = 0.75}};
      preset.lidar.firings_per_revolution = 360;
      preset.drive.between_stops = 60.0;
      preset.sessions =
          on_their_days({Route{{0, 0}, {1, 0}, {1, 1}, {2, 1}, {2, 2}}, Route{{2, 0}, {2, 1}, {1, 1}, {1, 0}, {2, 0}},
                         Route{{0, 1}, {1, 1}, {2, 1}, {2, 2}, {1, 2}}, Route{{0, 0}, {0, 1}, {1, 1}, {1, 0}, {2, 0}},
                         Route{{1, 2}, {2, 2}, {2, 1}, {1, 1}, {0, 1}}});
      break;
    case PresetSize::medium:
      campus.passages = {{.from = {1, 1}, .to = {2, 1}, .kind = PassageKind::corridor},
                         {.from = {1, 1}, .to = {1, 2}, .kind = PassageKind::corridor},
                         {.from = {2, 2}, .to = {2, 3}, .kind = PassageKind::corridor}};
      preset.sessions = walks(4, 4, 18);
      break;
    case PresetSize::large:
      campus.streets.columns = 8;
      campus.streets.rows = 5;
      campus.passages = {{.from = {2, 1}, .to = {3, 1}, .kind = PassageKind::corridor},
                         {.from = {3, 1}, .to = {3, 2}, .kind = PassageKind::corridor},
                         {.from = {5, 3}, .to = {6, 3}, .kind = PassageKind::corridor}};
      preset.sessions = walks(8, 5, 71);
      break;
    case PresetSize::full:
      campus.streets.columns = 12;
      campus.streets.rows = 7;
      campus.passages = {{.from = {3, 2}, .to = {4, 2}, .kind = PassageKind::corridor},
                         {.from = {4, 2}, .to = {5, 2}, .kind = PassageKind::corridor},
                         {.from = {6, 3}, .to = {6, 4}, .kind = PassageKind::corridor},
                         {.from = {8, 4}, .to = {9, 4}, .kind = PassageKind::corridor}};
      preset.sessions = walks(12, 7, 108);
      break;
  }
  return preset;
}

Preset mars_like(PresetSize size) {
  Preset preset = preset_named("mars-like", "a car in a town of avenues in five sessions over a year, in traffic");
  add_errors(preset);
  drive_a_car(preset.drive);
  preset.drive.between_stops = 500.0;
  preset.layout = FileLayout::nuscenes;
  TownOptions& town = preset.town;
  town.streets = {
      .columns = 6, .rows = 5, .block = 150.0, .irregularity = 0.15, .jitter = 8.0, .half_road = 8.0, .pavement = 3.0};
  town.steepness = 0.05;
  town.clear_of_crossing = 20.0;  // streets as wide as these reach far into each other where they meet askew
  town.max_storeys = 8;
  town.houses = {.least_width = 10.0,
                 .most_width = 28.0,
                 .least_depth = 10.0,
                 .most_depth = 18.0,
                 .at_the_street = 0.4,
                 .most_setback = 6.0};
  town.open_sides = 0.1;
  town.alike = 0.3;
  town.scaffolds = 0.05;
  town.built_later = 0.04;
  town.area_per_tree = 120.0;
  preset.traffic = {.companions = 6,
                    .beside = 3.3,
                    .between_oncoming = 3.0,
                    .oncoming_lane = 6.7,
                    .between_people = 4.0,
                    .lane = preset.drive.lane,
                    .least_aside = 8.7,
                    .most_aside = 10.5,
                    .reach = 140.0};
  preset.imu.rate = 10.0;
  preset.lidar.kind = LidarKind::vls_128;
  preset.lidar.T_body_lidar = nominal_T_ego_imu().inverse() * nominal_T_ego_lidar();
  preset.lidar.firings_per_revolution = 468;
  preset.lidar.max_range = 150.0;
  preset.gnss.rate = 10.0;
  preset.gnss.antenna_body = nominal_T_ego_imu().inverse() * nominal_antenna_ego();
  const auto tunnel = [](Crossing from, Crossing to) {
    return Passage{.from = from, .to = to, .kind = PassageKind::tunnel, .begin = 0.25, .end = 0.75};
  };
  switch (size) {
    case PresetSize::small:
      town.streets.columns = 4;
      town.streets.rows = 3;
      town.streets.block = 100.0;
      town.passages = {tunnel({1, 1}, {2, 1})};
      preset.lidar.firings_per_revolution = 150;
      preset.sessions = on_their_days(
          {Route{{0, 0}, {1, 0}, {1, 1}, {2, 1}, {2, 2}, {1, 2}, {0, 2}, {0, 1}, {1, 1}, {2, 1}, {3, 1}},
           Route{{3, 0}, {3, 1}, {2, 1}, {1, 1}, {1, 0}, {2, 0}, {2, 1}, {2, 2}, {1, 2}, {1, 1}, {0, 1}},
           Route{{0, 2}, {1, 2}, {2, 2}, {2, 1}, {1, 1}, {0, 1}, {0, 0}, {1, 0}, {1, 1}, {1, 2}, {0, 2}},
           Route{{3, 2}, {3, 1}, {3, 0}, {2, 0}, {2, 1}, {1, 1}, {1, 2}, {2, 2}, {2, 1}, {3, 1}, {3, 0}},
           Route{{2, 0}, {1, 0}, {0, 0}, {0, 1}, {1, 1}, {2, 1}, {3, 1}, {3, 2}, {2, 2}, {2, 1}, {2, 0}}});
      break;
    case PresetSize::medium:
    case PresetSize::large:
      town.passages = {tunnel({2, 2}, {3, 2}), tunnel({1, 3}, {1, 2})};
      preset.sessions = walks(6, 5, 41);
      break;
    case PresetSize::full:
      town.streets.columns = 21;
      town.streets.rows = 11;
      town.passages = {tunnel({5, 5}, {6, 5}), tunnel({6, 5}, {7, 5}), tunnel({13, 3}, {13, 4}),
                       tunnel({9, 8}, {10, 8})};
      preset.sessions = walks(21, 11, 577);
      break;
  }
  return preset;
}

}  // namespace chainslam::simulator
