#include "simulator/nclt_files.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>

#include "chainslam/core/byte_archive.hpp"
#include "simulator/rig.hpp"

namespace chainslam::simulator {

namespace {

std::uint16_t quantized(float metres) {
  return static_cast<std::uint16_t>(std::clamp(std::lround((static_cast<double>(metres) + 100.0) / 0.005), 0L, 65535L));
}

/// One line of comma-separated values.
class Line {
 public:
  explicit Line(Timestamp time) : text_(std::to_string(time.nanoseconds() / 1000)) {}

  Line& integer(int value) {
    text_ += ',' + std::to_string(value);
    return *this;
  }
  /// With as many decimals as asked for; "nan" where it is not a number.
  Line& number(double value, int decimals) {
    std::array<char, 64> digits{};
    const auto end =
        std::to_chars(digits.data(), digits.data() + digits.size(), value, std::chars_format::fixed, decimals);
    (text_ += ',').append(digits.data(), end.ptr);
    return *this;
  }
  Line& vector(const Eigen::Vector3d& value, int decimals) {
    for (int axis = 0; axis < 3; ++axis) number(value[axis], decimals);
    return *this;
  }
  [[nodiscard]] std::string finished() { return std::move(text_ += '\n'); }

 private:
  std::string text_;
};

/// Roll, pitch and yaw of R = Rz(yaw) Ry(pitch) Rx(roll), away from the poles.
Eigen::Vector3d to_roll_pitch_yaw(const SO3d& rotation) {
  const Eigen::Matrix3d R = rotation.matrix();
  return {std::atan2(R(2, 1), R(2, 2)), -std::asin(std::clamp(R(2, 0), -1.0, 1.0)), std::atan2(R(1, 0), R(0, 0))};
}

}  // namespace

std::vector<std::byte> HitsFile::encode(const Revolution& revolution, const SpinningLidar& lidar, Timestamp epoch) {
  constexpr std::uint16_t magic = 44444;
  std::vector<std::byte> bytes;
  bytes.reserve(revolution.returns.size() * 8 + 2048);
  auto first = revolution.returns.begin();
  const Index in_packet = lidar.model().firings_per_packet;
  const bool some_are_lost = lidar.options().lost_packets > 0.0;
  for (Index firing = 0; firing < lidar.options().firings_per_revolution; firing += in_packet) {
    const Index next_packet = firing + in_packet;
    const auto last = std::find_if(first, revolution.returns.end(),
                                   [&](const LidarReturn& hit) { return hit.firing >= next_packet; });
    if (some_are_lost && first == last) continue;
    const Timestamp time = epoch + revolution.start + lidar.firing_offset(firing);
    for (int i = 0; i < 4; ++i) append_bytes(bytes, magic);
    append_bytes(bytes, static_cast<std::uint32_t>(last - first));
    append_bytes(bytes, static_cast<std::uint64_t>(time.nanoseconds() / 1000));
    append_bytes(bytes, std::uint32_t{0});
    for (; first != last; ++first) {
      append_bytes(bytes, quantized(first->position.x()));  // z up to z down: y and z change sign
      append_bytes(bytes, quantized(-first->position.y()));
      append_bytes(bytes, quantized(-first->position.z()));
      append_bytes(bytes, first->intensity);
      append_bytes(bytes, first->laser);
    }
  }
  return bytes;
}

void write_ms25(const std::filesystem::path& path, const TownDrive& drive) {
  const Eigen::Vector3d field_map(0.18, 0.02, -0.5);  // gauss; north and down in Michigan
  const SO3d flip = flip_axes().rotation();
  AtomicFile file(path);
  for (const ImuSample& sample : drive.imu()) {
    const SO3d R_body_map = drive.truth(sample.time).rotation().inverse();
    file.write(Line(sample.time)
                   .vector(flip * (R_body_map * field_map), 5)
                   .vector(flip * sample.accel, 6)
                   .vector(flip * sample.gyro, 7)
                   .finished());
  }
  file.commit();
}

void write_gps(const std::filesystem::path& path, const TownDrive& drive) {
  AtomicFile file(path);
  for (const GnssReading& reading : drive.gnss())
    file.write(Line(reading.time)
                   .integer(reading.mode)
                   .integer(reading.satellites)
                   .number(reading.latitude, 12)
                   .number(reading.longitude, 12)
                   .number(reading.altitude, 3)
                   .number(reading.track, 4)
                   .number(reading.speed, 3)
                   .finished());
  file.commit();
}

void write_ground_truth(const std::filesystem::path& path, const TownDrive& drive) {
  constexpr Duration phase = std::chrono::milliseconds(13);
  constexpr Duration period = std::chrono::milliseconds(50);
  AtomicFile file(path);
  for (Timestamp time = drive.epoch() + phase; time <= drive.end(); time = time + period) {
    const SE3d T_ned_base = flip_axes() * drive.truth(time) * flip_axes() * nominal_T_base_ms25().inverse();
    file.write(
        Line(time).vector(T_ned_base.translation(), 6).vector(to_roll_pitch_yaw(T_ned_base.rotation()), 9).finished());
  }
  file.commit();
}

}  // namespace chainslam::simulator
