#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <string>
#include <utility>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/io/detail/point_records.hpp"
#include "datasets/nclt.hpp"

namespace chainslam::datasets {
namespace {

constexpr std::size_t hit_bytes = 8;
constexpr std::uint16_t magic = 44444;
constexpr std::uint32_t most_hits = 384 * 16;  // real packets hold at most 384
constexpr Duration longest_pause = std::chrono::milliseconds(200);
constexpr Duration longest_sweep = std::chrono::seconds(1);
constexpr std::size_t most_sweep_points = std::size_t{1} << 20;
constexpr Duration longest_packet = std::chrono::milliseconds(5);

/// Coordinates are unsigned: read as signed, those beyond 63.84 m would wrap.
float metres(const std::byte* data) {
  return static_cast<float>(static_cast<double>(load_as<std::uint16_t>(data)) * 0.005 - 100.0);
}

Eigen::Vector3f position_of(const std::byte* hit) { return {metres(hit), metres(hit + 2), metres(hit + 4)}; }

float intensity_of(const std::byte* hit) { return static_cast<float>(load_as<std::uint8_t>(hit + 6)); }

/// Azimuth in turns, in [0, 1), 0 behind the sensor.
double turns_from_behind(const Eigen::Vector3f& p) {
  const double turns =
      std::atan2(static_cast<double>(p.y()), static_cast<double>(p.x())) / (2 * std::numbers::pi) + 0.5;
  return turns - std::floor(turns);
}

SE3d from_roll_pitch_yaw_deg(double roll, double pitch, double yaw, const Eigen::Vector3d& translation) {
  constexpr double rad = std::numbers::pi / 180;
  const Eigen::Quaterniond rotation = Eigen::AngleAxisd(yaw * rad, Eigen::Vector3d::UnitZ()) *
                                      Eigen::AngleAxisd(pitch * rad, Eigen::Vector3d::UnitY()) *
                                      Eigen::AngleAxisd(roll * rad, Eigen::Vector3d::UnitX());
  return SE3d(SO3d::from_quaternion(rotation), translation);
}

}  // namespace

std::optional<NcltPacket> read_nclt_packet(InputFile& file) {
  std::array<std::byte, 24> header{};
  const std::uint64_t start = file.offset();
  const std::size_t read = file.read_some(header);
  if (read == 0) return std::nullopt;
  const auto fail = [&](const std::string& found) {
    file.fail("byte " + std::to_string(start), found, "the file is damaged or was cut short: copy it again");
  };
  if (read < header.size()) fail("the end of the file within a packet's header");
  for (std::size_t i = 0; i < 4; ++i)
    if (load_as<std::uint16_t>(header.data() + 2 * i) != magic)
      fail("no packet (four times 44444 expected, found " +
           std::to_string(load_as<std::uint16_t>(header.data() + 2 * i)) + ")");
  const auto hits = load_as<std::uint32_t>(header.data() + 8);
  const auto microseconds = load_as<std::uint64_t>(header.data() + 12);
  if (hits > most_hits) fail("a packet of " + std::to_string(hits) + " hits; 384 are the most");
  if (microseconds > static_cast<std::uint64_t>(latest_nanoseconds) / 1000)
    fail("the time " + std::to_string(microseconds) + " us");
  std::vector<std::byte> bytes(hits * hit_bytes);
  file.read(bytes, "a packet's hits");
  NcltPacket packet;
  packet.time = Timestamp::from_microseconds(static_cast<std::int64_t>(microseconds));
  for (std::size_t i = 0; i < hits; ++i) {
    packet.positions.push_back(position_of(bytes.data() + i * hit_bytes));
    packet.intensities.push_back(intensity_of(bytes.data() + i * hit_bytes));
  }
  return packet;
}

void NcltSweeps::read_ahead() {
  const std::uint64_t start = file_.offset();
  try {
    packet_ = read_nclt_packet(file_);
  } catch (const IoError& error) {
    packet_.reset();
    damage_ = error.report().place + ": " + error.report().found + "; the " +
              std::to_string(file_.size().value_or(start) - start) + " bytes from byte " + std::to_string(start) +
              " on are not used";
  }
}

bool NcltSweeps::ends_here(const LidarScan& sweep, Timestamp last) {
  if (packet_->time - last > longest_pause || last - packet_->time > longest_pause ||
      (!sweep.cloud.empty() && packet_->time - sweep.time > longest_sweep) || sweep.cloud.size() >= most_sweep_points) {
    turning_ = false;
    return !sweep.cloud.empty();
  }
  const auto seen =
      std::ranges::find_if(packet_->positions, [](const auto& p) { return p.template head<2>().norm() > 0.5F; });
  if (seen == packet_->positions.end()) return false;
  const double now = turns_from_behind(*seen);
  if (!turning_) {
    azimuth_ = started_ = now;
    turning_ = true;
    return false;
  }
  const double before = azimuth_;
  azimuth_ += (now - before) - std::round(now - before);
  // Past a whole number of turns; the noise of the azimuth near it must not cut twice.
  return !sweep.cloud.empty() && std::floor(azimuth_) != std::floor(before) && std::abs(azimuth_ - started_) > 0.05;
}

void NcltSweeps::take(LidarScan& sweep) {
  const NcltPacket packet = std::move(*packet_);
  read_ahead();
  if (packet_ && packet_->time < packet.time) ++backward_;
  if (packet_ && packet_->time > packet.time && packet_->time - packet.time <= longest_packet)
    interval_ = packet_->time - packet.time;
  if (sweep.cloud.empty()) sweep.time = sweep.end = packet.time;
  const double start = to_seconds(packet.time - sweep.time);
  const double step = to_seconds(interval_) / static_cast<double>(std::max<std::size_t>(packet.positions.size(), 1));
  for (std::size_t i = 0; i < packet.positions.size(); ++i) {
    sweep.cloud.positions.push_back(packet.positions[i]);
    sweep.cloud.intensities.push_back(packet.intensities[i]);
    sweep.cloud.time_offsets.push_back(static_cast<float>(std::max(start + static_cast<double>(i) * step, 0.0)));
  }
  if (!packet.positions.empty()) sweep.end = std::max(sweep.end, packet.time + interval_);
}

std::optional<LidarScan> NcltSweeps::next() {
  while (packet_) {
    LidarScan sweep;
    std::optional<Timestamp> last;
    while (packet_ && !ends_here(sweep, last.value_or(packet_->time))) {
      last = packet_->time;
      take(sweep);
    }
    const double turned = std::abs(azimuth_ - started_);
    started_ = azimuth_;
    if (turned > 0.5) return sweep;
    if (!sweep.cloud.empty()) ++dropped_;
  }
  return std::nullopt;
}

PointCloud<float> read_nclt_sync(const std::filesystem::path& path) {
  return detail::read_point_records(path, hit_bytes, "velodyne_sync holds 8 bytes a point",
                                    [](const std::byte* hit, PointCloud<float>& cloud) {
                                      cloud.positions.push_back(position_of(hit));
                                      cloud.intensities.push_back(intensity_of(hit));
                                    });
}

SE3d nclt_T_body_velodyne() { return from_roll_pitch_yaw_deg(0.807, 0.166, -90.703, {0.002, -0.004, -0.957}); }

SE3d nclt_T_body_imu() { return SE3d(SO3d(), {-0.11, -0.18, -0.71}); }

SE3d half_turn_about_x() {
  return SE3d(SO3d::from_quaternion(Eigen::Quaterniond(0, 1, 0, 0)), Eigen::Vector3d::Zero());
}

}  // namespace chainslam::datasets
