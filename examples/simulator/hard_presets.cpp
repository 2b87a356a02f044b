#include "simulator/hard_presets.hpp"

#include "simulator/large_presets.hpp"

namespace chainslam::simulator {

namespace {

/// Where the sizes are from: see `error_sources`.
void add_hard_errors(Preset& preset) {
  LidarOptions& lidar = preset.lidar;
  lidar.elevation_offset_deg = 0.2;
  lidar.elevation_error_deg = 0.05;
  lidar.range_bias = 0.01;
  lidar.elevation_drift_deg = 0.02;
  lidar.range_drift = 0.02;
  lidar.range_noise = 0.015;
  lidar.lost_returns = 0.02;
  lidar.incidence_bias = 0.01;
  lidar.intensity_bias = 0.02;
  lidar.mirrored = 0.3;
  lidar.beam_width_deg = 0.17;
  lidar.wind = 0.15;
  lidar.drops = 5e-4;
  lidar.dimming = 2e-3;
  lidar.clock_offset = 0.015;
  lidar.clock_drift = 2e-6;
  lidar.clock_jitter = 0.008;
  lidar.lost_packets = 0.003;
  lidar.lost_scans = 0.003;
  lidar.mount_angle_deg = 0.5;
  lidar.mount_shift = 0.03;
  InertialOptions& imu = preset.imu;
  imu.gyro_warm_up = 3e-3;
  imu.accel_warm_up = 0.03;
  imu.shake_gyro = 0.01;
  imu.shake_accel = 0.5;
  imu.clock_jitter = 0.002;
  imu.gyro_range = 5.24;   // 300 deg/s
  imu.accel_range = 49.0;  // 5 g
}

Passage open_stretch(Crossing from, Crossing to) {
  return {.from = from, .to = to, .kind = PassageKind::open, .begin = 0.05, .end = 0.95};
}

Passage tunnel(Crossing from, Crossing to) {
  return {.from = from, .to = to, .kind = PassageKind::tunnel, .begin = 0.25, .end = 0.75};
}

}  // namespace

Preset nclt_hard(PresetSize size) {
  Preset preset = nclt_like(size);
  preset.name = "nclt-hard";
  preset.summary = "a segway on a campus in five sessions over a year, with harder errors and places";
  add_hard_errors(preset);
  preset.drive.sway_angle = 0.03;
  preset.drive.vibration_angle = 4e-3;
  preset.drive.vibration_height = 3e-3;
  preset.traffic.between_people = 3.0;
  preset.traffic.crowd = 4;
  preset.town.open_sides = 0.4;
  preset.town.alike = 0.35;
  if (size == PresetSize::small || size == PresetSize::full) return preset;
  // In the paper's configuration the IMU hardly counts, and a campus is never out of sight: ground that each scan bends
  // is what drifts.
  preset.lidar.elevation_offset_deg = 0.45;
  auto& passages = preset.town.passages;
  if (size == PresetSize::medium) {
    preset.town.streets.columns = 5;
    preset.sessions = walks(5, 4, 21);
    passages.insert(passages.end(), {open_stretch({0, 1}, {0, 2}), open_stretch({3, 1}, {4, 1})});
  } else {
    passages.insert(passages.end(), {open_stretch({0, 1}, {0, 2}), open_stretch({4, 1}, {5, 1}),
                                     open_stretch({1, 3}, {2, 3}), open_stretch({6, 2}, {6, 3})});
  }
  return preset;
}

Preset mars_hard(PresetSize size) {
  Preset preset = mars_like(size);
  preset.name = "mars-hard";
  preset.summary = "a car in a town of avenues in five sessions over a year, with harder errors and places";
  add_hard_errors(preset);
  preset.lidar.clock_offset = 0.02;  // of a car that is not wired for it
  preset.lidar.clock_jitter = 0.015;
  preset.lidar.encoder_eccentricity_deg = 0.05;
  preset.traffic.companions = 9;
  preset.traffic.gap = 9.0;
  preset.traffic.on_both_sides = true;
  preset.town.open_sides = 0.4;
  preset.town.alike = 0.4;
  if (size == PresetSize::small || size == PresetSize::full) return preset;
  // Wide enough for a drive to be far from where it was: all that is within 500 m is in FAST-LIO2's map, and holds it.
  preset.lidar.firings_per_revolution = 312;  // every sixth
  preset.town.streets.columns = 5;
  preset.town.streets.rows = 4;
  preset.town.streets.block = size == PresetSize::medium ? 300.0 : 520.0;
  preset.sessions = walks(5, 4, size == PresetSize::medium ? 10 : 12);
  preset.town.passages = {tunnel({2, 2}, {3, 2}),       tunnel({1, 1}, {1, 2}),       open_stretch({0, 1}, {0, 2}),
                          open_stretch({3, 1}, {4, 1}), open_stretch({2, 0}, {3, 0}), open_stretch({3, 2}, {3, 3}),
                          open_stretch({4, 2}, {4, 3}), open_stretch({2, 3}, {3, 3})};
  return preset;
}

}  // namespace chainslam::simulator
