#include "simulator/nuscenes_files.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <string_view>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/io/atomic_file.hpp"
#include "simulator/angle.hpp"
#include "simulator/rig.hpp"

namespace chainslam::simulator {

namespace {

namespace fs = std::filesystem;

constexpr const char* lidar_channel = "LIDAR_FRONT_CENTER";
constexpr const char* imu_channel = "IMU_TOP";

/// Thousands of small files: they are not each forced to the disk.
struct UnhurriedFileSystem : RealFileSystem {
  int sync(int) { return 0; }
  int sync_directory(const fs::path&) { return 0; }
};

/// 32 hexadecimal digits, as nuScenes names its records: what it is, of which session, and its number.
std::string token(unsigned kind, std::size_t session, Index number) {
  std::string text(40, '\0');
  const int size = std::snprintf(text.data(), text.size(), "%08x%08x%016x", kind + 1U,
                                 static_cast<unsigned>(session + 1), static_cast<unsigned>(number));
  text.resize(static_cast<std::size_t>(size));
  return text;
}

std::string number(double value) {
  std::array<char, 64> digits{};
  return {digits.data(), std::to_chars(digits.data(), digits.data() + digits.size(), value).ptr};
}

std::string array(const Eigen::Vector3d& v) {
  return '[' + number(v.x()) + ", " + number(v.y()) + ", " + number(v.z()) + ']';
}

std::string micros(Timestamp time) { return std::to_string(time.nanoseconds() / 1000); }

/// One JSON object.
class Row {
 public:
  Row& raw(std::string_view key, const std::string& value) {
    ((text_ += text_.empty() ? "{\"" : ", \"") += key) += "\": " + value;
    return *this;
  }
  Row& string(std::string_view key, const std::string& value) { return raw(key, '"' + value + '"'); }
  Row& pose(const SE3d& T) {
    const auto& q = T.rotation().quaternion();
    return raw("rotation",
               '[' + number(q.w()) + ", " + number(q.x()) + ", " + number(q.y()) + ", " + number(q.z()) + ']')
        .raw("translation", array(T.translation()));
  }
  [[nodiscard]] std::string finished() const { return text_ + '}'; }

 private:
  std::string text_;
};

/// The fix that is stamped nearest, if it is one.
const GnssReading* fix_near(const std::vector<GnssReading>& gnss, Timestamp time) {
  const auto after = std::ranges::lower_bound(gnss, time, {}, &GnssReading::time);
  const GnssReading* best = nullptr;
  for (auto reading = after == gnss.begin() ? after : after - 1; reading != gnss.end() && reading <= after; ++reading)
    if (best == nullptr || std::abs((reading->time - time).count()) < std::abs((best->time - time).count()))
      best = &*reading;
  return best != nullptr && best->mode != 0 ? best : nullptr;
}

std::string imu_record(const ImuSample& imu, const GnssReading* fix, const Motion& motion) {
  Row row;
  row.raw("utime", micros(imu.time));
  if (fix != nullptr) {
    row.raw("lat", number(fix->latitude / degree)).raw("lon", number(fix->longitude / degree));
    if (std::isfinite(fix->altitude)) row.raw("elev", number(fix->altitude));
  }
  const Eigen::Vector3d v = motion.velocity_map;  // x north, y west
  return row.raw("vel", array({-v.y(), v.x(), v.z()}))
      .raw("avel", array(imu.gyro))
      .raw("acc", array(imu.accel))
      .finished();
}

std::span<const std::byte> bytes_of(const std::string& text) { return std::as_bytes(std::span(text)); }

}  // namespace

NuscenesFolder::NuscenesFolder(const fs::path& root, const Preset& preset, std::vector<fs::path>& made)
    : root_(root), made_(made), labelled_(preset.labelled) {
  std::vector<fs::path> folders{"v1.0", "sweeps", fs::path("sweeps") / lidar_channel, fs::path("sweeps") / imu_channel};
  if (labelled_) folders.insert(folders.end(), {"lidarseg", fs::path("lidarseg") / "v1.0"});
  for (const fs::path& folder : folders) fs::create_directory(made_.emplace_back(root_ / folder));
  add_rig(preset);
}

void NuscenesFolder::add_row(Table table, const std::string& row) {
  std::string& rows = rows_[table];
  (rows += rows.empty() ? "[\n" : ",\n") += row;
}

void NuscenesFolder::add_rig(const Preset& preset) {
  const SE3d T_ego_lidar = nominal_T_ego_imu() * preset.lidar.T_body_lidar;
  const auto add = [&](Index number, const char* channel, const char* modality, const SE3d& T) {
    add_row(sensor, Row()
                        .string("token", token(sensor, 0, number))
                        .string("channel", channel)
                        .string("modality", modality)
                        .finished());
    add_row(calibrated_sensor, Row()
                                   .string("token", token(calibrated_sensor, 0, number))
                                   .string("sensor_token", token(sensor, 0, number))
                                   .pose(T)
                                   .raw("camera_intrinsic", "[]")
                                   .finished());
  };
  add(0, lidar_channel, "lidar", T_ego_lidar);
  add(1, imu_channel, "imu", nominal_T_ego_imu());
  if (!labelled_) return;
  constexpr std::array names{"lasting", "changing", "moving"};
  for (Index i = 0; i < 3; ++i)
    add_row(category, Row()
                          .string("token", token(category, 0, i))
                          .string("name", names[static_cast<std::size_t>(i)])
                          .string("description", "")
                          .raw("index", std::to_string(i))
                          .finished());
}

void NuscenesFolder::write_file(const fs::path& name, std::span<const std::byte> bytes) {
  BasicAtomicFile<UnhurriedFileSystem> file(made_.emplace_back(root_ / name));
  file.write(bytes);
  file.commit();
}

void NuscenesFolder::begin_scene(std::size_t session, const TownDrive& drive) {
  drive_ = &drive;
  session_ = session;
  const std::string name = "session" + std::to_string(session + 1);
  const Index first = arriving(0, 1);
  Index count = 0;
  for (Index i = first; i < drive.scan_count(); i = arriving(i + 1, 1)) ++count;
  const Index last = arriving(drive.scan_count() - 1, -1);
  add_row(log, Row()
                   .string("token", token(log, session, 0))
                   .string("logfile", name)
                   .string("vehicle", "simulated")
                   .string("date_captured", "")
                   .string("location", "town")
                   .finished());
  add_row(scene, Row()
                     .string("token", token(scene, session, 0))
                     .string("log_token", token(log, session, 0))
                     .raw("nbr_samples", std::to_string(count))
                     .string("first_sample_token", token(sample, session, first))
                     .string("last_sample_token", token(sample, session, last))
                     .string("name", name)
                     .string("description", "")
                     .finished());
  write_imu();
}

Index NuscenesFolder::arriving(Index from, Index direction) const {
  while (from >= 0 && from < drive_->scan_count() && !drive_->lidar().arrives(from)) from += direction;
  return from;
}

void NuscenesFolder::add_sample_data(Table kind, Index index, Index sample_index, Index count, Timestamp time, bool key,
                                     const std::string& name) {
  const auto neighbour = [&](Index i) {
    return i < 0 || i >= count ? std::string() : token(sample_data + 16U * kind, session_, i);
  };
  const bool is_lidar = kind == sample;
  const Index previous = is_lidar ? arriving(index - 1, -1) : index - 1;
  const Index next = is_lidar ? arriving(index + 1, 1) : index + 1;
  add_row(sample_data, Row()
                           .string("token", neighbour(index))
                           .string("sample_token", token(sample, session_, sample_index))
                           .string("ego_pose_token", token(ego_pose, session_, sample_index))
                           .string("calibrated_sensor_token", token(calibrated_sensor, 0, is_lidar ? 0 : 1))
                           .raw("timestamp", micros(time))
                           .string("fileformat", is_lidar ? "pcd" : "json")
                           .raw("is_key_frame", key ? "true" : "false")
                           .raw("height", "0")
                           .raw("width", "0")
                           .string("filename", name)
                           .string("prev", neighbour(previous))
                           .string("next", neighbour(next))
                           .finished());
}

void NuscenesFolder::write_imu() {
  const std::vector<ImuSample>& imu = drive_->imu();
  const auto count = to_index(imu.size());
  Index nearest_sample = arriving(0, 1);
  for (Index i = 0; i < count; ++i) {
    const ImuSample& one = imu[static_cast<std::size_t>(i)];
    const auto distance = [&](Index s) { return std::abs((sample_time(s) - one.time).count()); };
    for (Index next = arriving(nearest_sample + 1, 1);
         next < drive_->scan_count() && distance(next) <= distance(nearest_sample); next = arriving(next + 1, 1))
      nearest_sample = next;
    const fs::path name = fs::path("sweeps") / imu_channel / (micros(one.time) + ".json");
    const double since = to_seconds(one.time - drive_->epoch());
    write_file(name, bytes_of(imu_record(one, fix_near(drive_->gnss(), one.time), drive_->drive().motion(since))));
    add_sample_data(scene, i, nearest_sample, count, one.time, distance(nearest_sample) < 5'000'000, name.string());
  }
}

std::vector<std::byte> NuscenesFolder::encode(const Revolution& revolution, const SpinningLidar& lidar) {
  std::vector<std::byte> bytes;
  bytes.reserve(revolution.returns.size() * 20);
  for (const LidarReturn& hit : revolution.returns) {
    for (int axis = 0; axis < 3; ++axis) append_bytes(bytes, hit.position[axis]);
    append_bytes(bytes, static_cast<float>(hit.intensity));
    append_bytes(bytes, static_cast<float>(lidar.model().channels[hit.laser].ring));
  }
  return bytes;
}

void NuscenesFolder::add_scan(Index index, const Revolution& revolution, std::span<const std::byte> bytes) {
  const Timestamp time = sample_time(index);
  const Index count = drive_->scan_count();
  const auto neighbour = [&](Index i) { return i < 0 || i >= count ? std::string() : token(sample, session_, i); };
  add_row(sample, Row()
                      .string("token", neighbour(index))
                      .raw("timestamp", micros(time))
                      .string("prev", neighbour(arriving(index - 1, -1)))
                      .string("next", neighbour(arriving(index + 1, 1)))
                      .string("scene_token", token(scene, session_, 0))
                      .finished());
  const SE3d T_map_ego = drive_->truth(time) * nominal_T_ego_imu().inverse();
  add_row(ego_pose, Row()
                        .string("token", token(ego_pose, session_, index))
                        .raw("timestamp", micros(time))
                        .pose(T_map_ego)
                        .finished());
  const fs::path name = fs::path("sweeps") / lidar_channel / (micros(time) + ".pcd.bin");
  write_file(name, bytes);
  add_sample_data(sample, index, index, count, time, true, name.string());
  if (!labelled_) return;
  const std::string data_token = token(sample_data + 16U * sample, session_, index);
  const fs::path labels = fs::path("lidarseg") / "v1.0" / (data_token + "_lidarseg.bin");
  std::vector<std::byte> presences;
  for (const LidarReturn& hit : revolution.returns) presences.push_back(static_cast<std::byte>(hit.presence));
  write_file(labels, presences);
  add_row(lidarseg, Row()
                        .string("token", token(lidarseg, session_, index))
                        .string("sample_data_token", data_token)
                        .string("filename", labels.string())
                        .finished());
}

void NuscenesFolder::finish() {
  constexpr std::array names{"log",         "sensor",   "calibrated_sensor", "scene",   "sample",
                             "sample_data", "ego_pose", "category",          "lidarseg"};
  static_assert(names.size() == tables);
  for (std::size_t i = 0; i < names.size(); ++i) {
    if (rows_[i].empty()) continue;
    AtomicFile file(made_.emplace_back(root_ / "v1.0" / (std::string(names[i]) + ".json")));
    file.write(rows_[i] + "\n]\n");
    file.commit();
  }
}

}  // namespace chainslam::simulator
