#include "datasets/recorded_rows.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <limits>
#include <optional>
#include <string_view>

#include "chainslam/io/detail/pose_fields.hpp"
#include "chainslam/io/detail/text.hpp"

namespace chainslam::datasets {
namespace {

constexpr std::array<std::string_view, 3> statuses{"good", "degenerate", "lost"};
/// The uses, then what is more than one of them says: none is stated, and the accelerometer is left out by the
/// settings.
constexpr std::array<std::string_view, 6> imu_uses{"all",  "gyroscope", "rough_gyroscope",
                                                   "none", "",          "gyroscope_as_set"};
constexpr std::size_t no_imu_use = 4, gyroscope_as_set = 5;
constexpr std::array<std::string_view, 6> qualities{"none",         "two_dimensional", "three_dimensional",
                                                    "differential", "rtk_float",       "rtk_fixed"};

template <class Number>
void append(std::string& row, Number value) {
  row += ',';
  detail::append_number(row, value);
}

/// The position of a field's word among those that are known.
template <std::size_t Size>
std::size_t read_word(LineFields& fields, const char* name, const std::array<std::string_view, Size>& words) {
  const std::string_view word = fields.text(name);
  const auto found = std::ranges::find(words, word);
  if (found != words.end()) return static_cast<std::size_t>(found - words.begin());
  std::string known;
  for (const std::string_view each : words) known += (known.empty() ? "" : ", ") + std::string(each);
  fields.fail(name, detail::shown(word), "write one of " + known);
}

std::int64_t read_integer(LineFields& fields, const char* name, std::int64_t least, std::int64_t greatest) {
  const std::int64_t value = fields.integer(name);
  if (value < least || value > greatest)
    fields.fail(name, std::to_string(value),
                "write a whole number from " + std::to_string(least) + " to " + std::to_string(greatest));
  return value;
}

Index read_index(LineFields& fields, const char* name) {
  return static_cast<Index>(read_integer(fields, name, 0, std::numeric_limits<Index>::max()));
}

bool read_flag(LineFields& fields, const char* name) { return read_integer(fields, name, 0, 1) == 1; }

/// @throws IoError if a variance is negative or not finite.
PackedCovariance read_covariance(LineFields& fields) {
  std::array<float, PackedCovariance::entries> upper{};
  std::size_t k = 0;
  for (std::size_t i = 0; i < 6; ++i)
    for (std::size_t j = i; j < 6; ++j) {
      upper[k] = static_cast<float>(fields.number("covariance"));
      if (!std::isfinite(upper[k]) || (i == j && upper[k] < 0))
        fields.fail("covariance", std::to_string(upper[k]), "write a covariance: its diagonal is not negative");
      ++k;
    }
  return PackedCovariance(upper);
}

/// Nothing if all three fields are empty.
std::optional<Eigen::Vector3f> read_delta_velocity(LineFields& fields) {
  std::array<std::string_view, 3> texts{};
  for (std::string_view& text : texts) text = fields.text("delta velocity");
  if (std::ranges::all_of(texts, &std::string_view::empty)) return std::nullopt;
  Eigen::Vector3f gained;
  for (int axis = 0; axis < 3; ++axis) {
    const std::string_view text = texts[static_cast<std::size_t>(axis)];
    const auto value = detail::parse_double(text);
    if (!value || !std::isfinite(static_cast<float>(*value)))
      fields.fail("delta velocity", detail::shown(text), "write three finite numbers, or leave all three empty");
    gained[axis] = static_cast<float>(*value);
  }
  return gained;
}

SE3d read_pose(LineFields& fields) {
  const Eigen::Vector3d position = detail::read_position(fields);
  return SE3d(detail::read_quaternion(fields, detail::QuaternionOrder::xyzw), position);
}

/// The columns that recordings of all versions have.
FrameRow read_common_fields(LineFields& fields) {
  FrameRow row;
  row.frame.time = Timestamp::from_nanoseconds(fields.integer("time_ns"));
  row.keyframe = read_integer(fields, "keyframe", -1, std::numeric_limits<Index>::max());
  FrameHealth& health = row.frame.health;
  health.status = static_cast<FrameStatus>(read_word(fields, "status", statuses));
  health.map_restarted = read_flag(fields, "map_restarted");
  health.after_gap = read_flag(fields, "after_gap");
  const std::size_t use = read_word(fields, "imu_use", imu_uses);
  health.imu_as_set = use == gyroscope_as_set;
  if (use != no_imu_use) health.imu_use = health.imu_as_set ? ImuUse::gyroscope : static_cast<ImuUse>(use);
  health.points = read_index(fields, "points");
  health.matches = read_index(fields, "matches");
  health.iterations = read_index(fields, "iterations");
  health.residual_rms = fields.number("residual_rms_m");
  row.frame.T_odom_body = read_pose(fields);
  row.frame.covariance = read_covariance(fields);
  return row;
}

std::string common_columns() {
  constexpr std::array<std::string_view, 6> axes{"x", "y", "z", "rx", "ry", "rz"};
  std::string head =
      "time_ns,keyframe,status,map_restarted,after_gap,imu_use,points,matches,iterations,residual_rms_m,x,y,z,qx,qy,qz,"
      "qw";
  for (std::size_t i = 0; i < axes.size(); ++i)
    for (std::size_t j = i; j < axes.size(); ++j) head.append(",cov_").append(axes[i]).append("_").append(axes[j]);
  return head;
}

}  // namespace

std::string frame_table_head() { return common_columns() + ",dv_x,dv_y,dv_z\n"; }

std::string earlier_frame_table_head() { return common_columns() + '\n'; }

std::string fix_table_head() {
  std::string head = "frames_before,time_ns,quality,ecef_x,ecef_y,ecef_z";
  for (const char row : std::string_view("xyz"))
    for (const char column : std::string_view("xyz")) head.append(",cov_").append(1, row).append(1, column);
  return head + '\n';
}

std::string text_of(const FrameRow& row) {
  const FrameHealth& health = row.frame.health;
  std::string text = std::to_string(row.frame.time.nanoseconds());
  append(text, row.keyframe);
  text.append(",").append(statuses[static_cast<std::size_t>(health.status)]);
  append(text, static_cast<int>(health.map_restarted));
  append(text, static_cast<int>(health.after_gap));
  text += ',';
  if (health.imu_as_set)
    text += imu_uses[gyroscope_as_set];
  else if (health.imu_use)
    text += imu_uses[static_cast<std::size_t>(*health.imu_use)];
  for (const Index count : {health.points, health.matches, health.iterations}) append(text, count);
  append(text, health.residual_rms);
  const Eigen::Vector3d& t = row.frame.T_odom_body.translation();
  const auto& q = row.frame.T_odom_body.rotation().quaternion();
  for (const double value : {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()}) append(text, value);
  for (const float entry : row.frame.covariance.upper()) append(text, entry);
  if (const auto& gained = row.frame.delta_velocity)
    for (int axis = 0; axis < 3; ++axis) append(text, (*gained)[axis]);
  else
    text += ",,,";
  return text + '\n';
}

std::string text_of(const FixRow& row) {
  std::string text = std::to_string(row.frames_before);
  append(text, row.fix.time.nanoseconds());
  text.append(",").append(qualities[static_cast<std::size_t>(row.fix.quality)]);
  for (int i = 0; i < 3; ++i) append(text, row.fix.position_ecef[i]);
  for (int i = 0; i < 9; ++i) append(text, row.fix.covariance_ecef(i / 3, i % 3));
  return text + '\n';
}

FrameRow read_frame_row(LineFields& fields) {
  FrameRow row = read_common_fields(fields);
  row.frame.delta_velocity = read_delta_velocity(fields);
  fields.end("41 fields: see the first line");
  return row;
}

FrameRow read_earlier_frame_row(LineFields& fields) {
  const FrameRow row = read_common_fields(fields);
  fields.end("38 fields: see the first line");
  return row;
}

FixRow read_fix_row(LineFields& fields) {
  FixRow row;
  row.frames_before = read_integer(fields, "frames_before", 0, std::numeric_limits<std::int64_t>::max());
  row.fix.time = Timestamp::from_nanoseconds(fields.integer("time_ns"));
  row.fix.quality = static_cast<GnssQuality>(read_word(fields, "quality", qualities));
  for (int i = 0; i < 3; ++i) row.fix.position_ecef[i] = fields.number("ecef");
  for (int i = 0; i < 9; ++i) row.fix.covariance_ecef(i / 3, i % 3) = fields.number("covariance");
  fields.end("15 fields: see the first line");
  return row;
}

}  // namespace chainslam::datasets
