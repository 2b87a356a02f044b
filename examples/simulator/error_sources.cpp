#include "simulator/error_sources.hpp"

#include <algorithm>
#include <array>
#include <iterator>
#include <stdexcept>

namespace chainslam::simulator {

namespace {

/// Nothing of what an error source stands for.
Preset ideal() {
  Preset preset = preset_named("ideal", "");
  LidarOptions& lidar = preset.lidar;
  lidar.range_noise = lidar.lost_returns = lidar.elevation_error_deg = lidar.range_bias = lidar.incidence_bias = 0.0;
  lidar.mount_angle_deg = lidar.mount_shift = 0.0;
  preset.imu = preset.imu.without_errors();
  DriveOptions& drive = preset.drive;
  drive.vibration_height = drive.vibration_angle = drive.dive = drive.lean = 0.0;
  return preset;
}

/// Passages of one kind.
template <PassageKind... kinds>
void copy_passages(Preset& to, const Preset& from) {
  const auto is_one = [](const Passage& passage) { return ((passage.kind == kinds) || ...); };
  std::erase_if(to.town.passages, is_one);
  std::ranges::copy_if(from.town.passages, std::back_inserter(to.town.passages), is_one);
}

/// Copies members of one part of a preset.
template <auto part, auto... members>
void copy_members(Preset& to, const Preset& from) {
  (static_cast<void>((to.*part).*members = (from.*part).*members), ...);
}

using Lidar = LidarOptions;
using Imu = InertialOptions;
using Others = TrafficOptions;

constexpr std::array<ErrorSource, 27> sources{{
    {"laser-angles", "lasers point higher or lower than their data sheet says, all together and each by itself",
     "KITTI's HDL-64E: 0.205 degrees as a whole (Deschaud 2018 found it, KISS-ICP corrects it by that); the larger "
     "sizes of nclt-hard have about twice as much, chosen so that FAST-LIO2 drifts as in the paper",
     copy_members<&Preset::lidar, &Lidar::elevation_offset_deg, &Lidar::elevation_error_deg>},
    {"encoder", "the circle that azimuths are read from is not centred: they are off by a cosine over the turn",
     "the effect: Muralikrishnan et al. 2015 (Precision Engineering 40); its size is chosen: 0.035 mm off the centre "
     "of a circle of 80 mm",
     copy_members<&Preset::lidar, &Lidar::encoder_eccentricity_deg>},
    {"laser-ranges", "every laser has a constant error of its own in range",
     "data sheets: accuracy of 2 cm (HDL-32E), 3 cm (VLS-128)", copy_members<&Preset::lidar, &Lidar::range_bias>},
    {"laser-warm-up", "both drift while the sensor warms up",
     "the effect: Glennie and Lichti 2011, doi 10.3390/rs3030539; its size is chosen",
     copy_members<&Preset::lidar, &Lidar::elevation_drift_deg, &Lidar::range_drift>},
    {"range-noise", "white noise in range, and returns that are lost whatever they meet",
     "data sheets: 2 cm, one sigma", copy_members<&Preset::lidar, &Lidar::range_noise, &Lidar::lost_returns>},
    {"incidence", "surfaces met at a grazing angle are measured too far",
     "the effect: Laconte et al. 2019; its size is chosen", copy_members<&Preset::lidar, &Lidar::incidence_bias>},
    {"intensity", "dark surfaces are measured too far", "the effect: Glennie et al. 2016 (VLP-16); its size is chosen",
     copy_members<&Preset::lidar, &Lidar::intensity_bias>},
    {"mirrors", "panes show what they mirror, behind them", "the effect: Koch et al. 2017; its size is chosen",
     copy_members<&Preset::lidar, &Lidar::mirrored>},
    {"mixed-pixels", "a spot that lies across an edge reports something in between",
     "data sheets: divergence of 3 mrad along the turn", copy_members<&Preset::lidar, &Lidar::beam_width_deg>},
    {"wind", "leaves sway", "chosen: a breeze", copy_members<&Preset::lidar, &Lidar::wind>},
    {"precipitation", "drops or flakes echo, and dim what lies behind",
     "the effect: Goodin et al. 2019; its size is chosen",
     copy_members<&Preset::lidar, &Lidar::drops, &Lidar::dimming>},
    {"traffic", "vehicles travel along, pass, and surround the own one",
     "chosen: 10 to 30 % of the returns are from vehicles that move",
     copy_members<&Preset::traffic, &Others::companions, &Others::gap, &Others::beside, &Others::on_both_sides,
                  &Others::between_oncoming>},
    {"people", "people are met, and walk along with a slow robot", "chosen: a campus between lectures",
     copy_members<&Preset::traffic, &Others::between_people, &Others::crowd>},
    {"vehicle-motion", "the vehicle pitches, leans, sways and trembles", "chosen: a segway sways by 1 to 2 degrees",
     copy_members<&Preset::drive, &DriveOptions::vibration_height, &DriveOptions::vibration_angle,
                  &DriveOptions::vibration_speed, &DriveOptions::dive, &DriveOptions::lean, &DriveOptions::sway_angle>},
    {"lidar-clock", "stamps of scans are off, drift and jitter", "KITTI's IMU: 67 ms late; here 1 to 20 ms",
     copy_members<&Preset::lidar, &Lidar::clock_offset, &Lidar::clock_drift, &Lidar::clock_jitter>},
    {"lost-data", "scans and packets do not arrive", "chosen: a few in a thousand",
     copy_members<&Preset::lidar, &Lidar::lost_packets, &Lidar::lost_scans>},
    {"imu-noise", "white noise and bias of gyroscopes and accelerometers", "data sheet of the 3DM-GX3-25",
     copy_members<&Preset::imu, &Imu::gyro_noise, &Imu::accel_noise, &Imu::gyro_bias, &Imu::accel_bias,
                  &Imu::gyro_bias_walk, &Imu::accel_bias_walk>},
    {"imu-warm-up", "biases drift while the IMU warms up", "chosen: of the size of the bias when switched on",
     copy_members<&Preset::imu, &Imu::gyro_warm_up, &Imu::accel_warm_up>},
    {"imu-axes", "scale and direction of each axis, and specific force felt by gyroscopes",
     "data sheet of the 3DM-GX3-25",
     copy_members<&Preset::imu, &Imu::scale, &Imu::misalignment_deg, &Imu::g_sensitivity>},
    {"imu-shaking", "engine and wheels shake the IMU, which samples without a filter",
     "KITTI's OXTS, measured against its trajectory while driving (see RecordedDrive's ImuAgreement)",
     copy_members<&Preset::imu, &Imu::shake_gyro, &Imu::shake_accel, &Imu::shake_frequency>},
    {"imu-clock", "time stamps of IMU measurements are off and jitter", "chosen: a serial port's milliseconds",
     copy_members<&Preset::imu, &Imu::clock_offset, &Imu::clock_jitter>},
    {"saturation", "measurements saturate at the range of the IMU", "data sheets: 300 deg/s, 5 g",
     copy_members<&Preset::imu, &Imu::gyro_range, &Imu::accel_range>},
    {"mounting", "the LiDAR is not quite where the calibration says", "chosen: tenths of a degree, a few centimetres",
     copy_members<&Preset::lidar, &Lidar::mount_angle_deg, &Lidar::mount_shift>},
    {"open-stretches", "long bridges: railings, and nothing beside them", "chosen: part of the world",
     copy_passages<PassageKind::open>},
    {"passages", "corridors and tunnels, whose walls are plain", "chosen: part of the world",
     copy_passages<PassageKind::corridor, PassageKind::tunnel>},
    {"lawns", "sides of streets without houses", "chosen: part of the world",
     copy_members<&Preset::town, &TownOptions::open_sides, &TownOptions::built>},
    {"alike", "sides of streets where all houses are the same", "chosen: part of the world",
     copy_members<&Preset::town, &TownOptions::alike>},
}};

/// Calls `visit` with each error source that is named.
template <class Visit>
void for_each_named(std::string_view names, const Visit& visit) {
  while (!names.empty()) {
    const std::size_t comma = std::min(names.find(','), names.size());
    const std::string_view name = names.substr(0, comma);
    names.remove_prefix(std::min(comma + 1, names.size()));
    const auto found = std::ranges::find(sources, name, &ErrorSource::name);
    if (found == sources.end() && name != "all")
      throw std::invalid_argument("there is no error source " + std::string(name) +
                                  "; there are: " + error_source_names());
    for (const ErrorSource& source : sources)
      if (name == "all" || source.name == name) visit(source);
  }
}

}  // namespace

std::span<const ErrorSource> error_sources() { return sources; }

std::string error_source_names() {
  std::string names;
  for (const ErrorSource& source : sources) (names += names.empty() ? "" : ", ") += source.name;
  return names;
}

Preset without_errors(const Preset& preset, std::string_view names) {
  const Preset none = ideal();
  Preset changed = preset;
  for_each_named(names, [&](const ErrorSource& source) { source.copy(changed, none); });
  return changed;
}

Preset with_only_errors(const Preset& preset, std::string_view names) {
  Preset changed = without_errors(preset, "all");
  for_each_named(names, [&](const ErrorSource& source) { source.copy(changed, preset); });
  return changed;
}

}  // namespace chainslam::simulator
