#include "simulator/preset_description.hpp"

#define XXH_INLINE_ALL
#include <xxhash.h>

#include <array>
#include <cassert>
#include <charconv>
#include <cstdint>
#include <cstdio>
#include <string_view>
#include <type_traits>

namespace chainslam::simulator {

namespace {

/// Lines of text, all below one heading.
class Lines {
 public:
  explicit Lines(std::string& text) : text_(text) {}

  /// @param names  of all values, separated by spaces.
  template <class... Values>
  void add(std::string_view part, std::string_view names, const Values&... values) {
    part_ = part;
    names_ = names;
    (line(values), ...);
    assert(names_.empty());
  }

 private:
  template <class Value>
  void line(const Value& value) {
    const std::size_t space = std::min(names_.find(' '), names_.size());
    ((text_ += part_) += '.') += names_.substr(0, space);
    text_ += " =";
    names_.remove_prefix(std::min(space + 1, names_.size()));
    write(value);
    text_ += '\n';
  }

  void write(double value) {
    std::array<char, 64> digits{};
    text_ += ' ';
    text_.append(digits.data(), std::to_chars(digits.data(), digits.data() + digits.size(), value).ptr);
  }
  void write(Index value) { text_ += ' ' + std::to_string(value); }
  void write(bool value) { text_ += value ? " true" : " false"; }
  template <class Enumeration>
    requires std::is_enum_v<Enumeration>
  void write(Enumeration value) { write(static_cast<Index>(value)); }
  void write(const Eigen::Vector3d& value) {
    for (int axis = 0; axis < 3; ++axis) write(value[axis]);
  }
  void write(const SE3d& T) {
    write(T.translation());
    for (int i = 0; i < 4; ++i) write(T.rotation().quaternion().coeffs()[i]);
  }
  void write(const Crossing& crossing) { write(crossing.column), write(crossing.row); }
  void write(const Passage& passage) {
    write(passage.from), write(passage.to), write(passage.kind), write(passage.begin), write(passage.end);
  }
  void write(const SessionPlan& session) { write(session.day), write(session.route); }
  template <class Value>
  void write(const std::vector<Value>& values) {
    for (const Value& value : values) text_ += " (", write(value), text_ += " )";
  }

  std::string& text_;
  std::string_view part_, names_;
};

// Each takes a structure apart into all of its members: one more of them does not compile until it stands here.

void add(Lines& lines, const StreetOptions& options) {
  const auto& [columns, rows, block, irregularity, jitter, half_road, pavement] = options;
  lines.add("streets", "columns rows block irregularity jitter half_road pavement", columns, rows, block, irregularity,
            jitter, half_road, pavement);
}

void add(Lines& lines, const HouseOptions& options) {
  const auto& [least_width, most_width, least_depth, most_depth, at_the_street, most_setback] = options;
  lines.add("houses", "least_width most_width least_depth most_depth at_the_street most_setback", least_width,
            most_width, least_depth, most_depth, at_the_street, most_setback);
}

void add(Lines& lines, const TownOptions& options) {
  const auto& [streets, steepness, ground_spacing, border, max_storeys, clear_of_crossing, parked, parked_anew,
               kerb_changes, houses, built, open_sides, alike, scaffolds, built_later, seasons, area_per_tree,
               passages] = options;
  add(lines, streets);
  add(lines, houses);
  lines.add("town",
            "steepness ground_spacing border max_storeys clear_of_crossing parked parked_anew kerb_changes built "
            "open_sides alike scaffolds built_later seasons area_per_tree passages",
            steepness, ground_spacing, border, max_storeys, clear_of_crossing, parked, parked_anew, kerb_changes, built,
            open_sides, alike, scaffolds, built_later, seasons, area_per_tree, passages);
}

void add(Lines& lines, const DriveOptions& options) {
  const auto& [lane, cruise, lateral_acceleration, acceleration, braking, rest_at_start, rest_at_end, stop_at,
               stop_duration, between_stops, body_height, vibration_height, vibration_angle, vibration_speed, dive,
               lean, sway_angle, sway_period, corners] = options;
  const auto& [left, right, bend] = corners;
  lines.add("drive",
            "lane cruise lateral_acceleration acceleration braking rest_at_start rest_at_end stop_at stop_duration "
            "between_stops body_height vibration_height vibration_angle vibration_speed dive lean sway_angle "
            "sway_period corners.left corners.right corners.bend",
            lane, cruise, lateral_acceleration, acceleration, braking, rest_at_start, rest_at_end, stop_at,
            stop_duration, between_stops, body_height, vibration_height, vibration_angle, vibration_speed, dive, lean,
            sway_angle, sway_period, left, right, bend);
}

void add(Lines& lines, const LidarOptions& options) {
  const auto& [kind, T_body_lidar, firings_per_revolution, period, max_range, min_range, range_noise, lost_returns,
               lost_packets, lost_scans, elevation_offset_deg, elevation_error_deg, encoder_eccentricity_deg,
               range_bias, elevation_drift_deg, range_drift, warm_up_time, incidence_bias, intensity_bias,
               mount_angle_deg, mount_shift, beam_width_deg, clock_offset, clock_drift, clock_jitter, mirrored, wind,
               drops, dimming] = options;
  lines.add("lidar",
            "kind T_body_lidar firings_per_revolution period max_range min_range range_noise lost_returns lost_packets "
            "lost_scans elevation_offset_deg elevation_error_deg encoder_eccentricity_deg range_bias "
            "elevation_drift_deg range_drift "
            "warm_up_time incidence_bias "
            "intensity_bias mount_angle_deg mount_shift beam_width_deg clock_offset clock_drift clock_jitter mirrored "
            "wind drops dimming",
            kind, T_body_lidar, firings_per_revolution, period, max_range, min_range, range_noise, lost_returns,
            lost_packets, lost_scans, elevation_offset_deg, elevation_error_deg, encoder_eccentricity_deg, range_bias,
            elevation_drift_deg, range_drift, warm_up_time, incidence_bias, intensity_bias, mount_angle_deg,
            mount_shift, beam_width_deg, clock_offset, clock_drift, clock_jitter, mirrored, wind, drops, dimming);
}

void add(Lines& lines, const InertialOptions& options) {
  const auto& [rate, gyro_noise, accel_noise, gyro_bias, accel_bias, gyro_bias_walk, accel_bias_walk, scale,
               misalignment_deg, gyro_warm_up, accel_warm_up, warm_up_time, g_sensitivity, shake_gyro, shake_accel,
               shake_frequency, clock_offset, clock_jitter, gyro_range, accel_range] = options;
  lines.add("imu",
            "rate gyro_noise accel_noise gyro_bias accel_bias gyro_bias_walk accel_bias_walk scale misalignment_deg "
            "gyro_warm_up accel_warm_up warm_up_time g_sensitivity shake_gyro shake_accel shake_frequency clock_offset "
            "clock_jitter gyro_range accel_range",
            rate, gyro_noise, accel_noise, gyro_bias, accel_bias, gyro_bias_walk, accel_bias_walk, scale,
            misalignment_deg, gyro_warm_up, accel_warm_up, warm_up_time, g_sensitivity, shake_gyro, shake_accel,
            shake_frequency, clock_offset, clock_jitter, gyro_range, accel_range);
}

void add(Lines& lines, const GnssOptions& options) {
  const auto& [rate, least_bias, most_bias, wander, wander_time, noise, vertical, time_between_outages, outage_duration,
               time_between_bursts, burst_duration, burst_size, flat_fixes, latency, needs_sky, antenna_body] = options;
  lines.add("gnss",
            "rate least_bias most_bias wander wander_time noise vertical time_between_outages outage_duration "
            "time_between_bursts burst_duration burst_size flat_fixes latency needs_sky antenna_body",
            rate, least_bias, most_bias, wander, wander_time, noise, vertical, time_between_outages, outage_duration,
            time_between_bursts, burst_duration, burst_size, flat_fixes, latency, needs_sky, antenna_body);
}

void add(Lines& lines, const TrafficOptions& options) {
  const auto& [companions, gap, beside, on_both_sides, crowd, between_oncoming, oncoming_lane, between_people, lane,
               least_aside, most_aside, reach] = options;
  lines.add("traffic",
            "companions gap beside on_both_sides crowd between_oncoming oncoming_lane between_people lane least_aside "
            "most_aside reach",
            companions, gap, beside, on_both_sides, crowd, between_oncoming, oncoming_lane, between_people, lane,
            least_aside, most_aside, reach);
}

}  // namespace

std::string describe_options(const Preset& preset) {
  std::string text;
  Lines lines(text);
  // What it is called and how it is written makes no other data.
  const auto& [name, summary, town, drive, lidar, imu, gnss, traffic, sessions, layout, labelled] = preset;
  static_cast<void>(name), static_cast<void>(summary), static_cast<void>(layout), static_cast<void>(labelled);
  add(lines, town);
  add(lines, drive);
  add(lines, lidar);
  add(lines, imu);
  add(lines, gnss);
  add(lines, traffic);
  lines.add("preset", "sessions", sessions);
  return text;
}

std::string options_hash(const Preset& preset) {
  const std::string text = describe_options(preset);
  std::array<char, 17> digits{};
  std::snprintf(digits.data(), digits.size(), "%016llx",
                static_cast<unsigned long long>(XXH3_64bits(text.data(), text.size())));
  return digits.data();
}

}  // namespace chainslam::simulator
