#include "datasets/nuscenes.hpp"

#include <algorithm>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/core/error.hpp"
#include "chainslam/io/detail/point_records.hpp"
#include "datasets/azimuth_times.hpp"
#include "datasets/dataset.hpp"
#include "datasets/extrinsic.hpp"
#include "datasets/files.hpp"
#include "datasets/geodesy.hpp"
#include "datasets/imu_conversion.hpp"
#include "datasets/json_table.hpp"
#include "datasets/merged_streams.hpp"
#include "datasets/scan_files.hpp"
#include "datasets/statistics.hpp"

// nuScenes' tables (Caesar et al. 2020, schema v1.0) as nuScenes and MARS (Li et al. 2024) have them: a scene is a
// recording. Clouds: float32 x y z intensity ring, no times; MARS's IMU_TOP: a JSON object for each sample with utime,
// lat, lon (deg), elev (m), avel (rad/s), acc (m/s^2). A LiDAR's stamp is the end of its turn, as nuScenes defines it.

namespace chainslam::datasets {
namespace {

namespace fs = std::filesystem;

/// A file of a sensor.
struct SampleData {
  Timestamp time;
  fs::path file;
  std::string ego_pose;
};

struct Mounting {
  std::string channel;
  SE3d T_ego_sensor;
};

SE3d pose_of(const JsonRow& row, const fs::path& table) {
  const auto* q = row.find("rotation", 4);
  const auto* t = row.find("translation", 3);
  const double norm = q == nullptr ? 0 : Eigen::Vector4d((*q)[0], (*q)[1], (*q)[2], (*q)[3]).norm();
  if (t == nullptr || !(norm > 0.9 && norm < 1.1))
    throw_input_error(table.string(), "token " + row.text("token"), "no rotation (w x y z, of length 1) or translation",
                      "the table is damaged: copy it again");
  const Eigen::Quaterniond rotation((*q)[0], (*q)[1], (*q)[2], (*q)[3]);
  return SE3d(SO3d::from_quaternion(rotation.normalized()), {(*t)[0], (*t)[1], (*t)[2]});
}

Timestamp time_of(const JsonRow& row, const fs::path& table) {
  const auto* time = row.find("timestamp", 1);
  if (time == nullptr || !((*time)[0] >= 0 && (*time)[0] <= 1e-3 * static_cast<double>(latest_nanoseconds)))
    throw_input_error(table.string(), "token " + row.text("token"), "no timestamp in microseconds",
                      "the table is damaged: copy it again");
  return Timestamp::from_microseconds(static_cast<std::int64_t>((*time)[0]));
}

/// x, y, z, intensity, ring as floats.
PointCloud<float> read_nuscenes_cloud(const fs::path& path) {
  return detail::read_point_records(
      path, 20, "nuScenes' clouds hold 20 bytes a point", [](const std::byte* record, PointCloud<float>& cloud) {
        cloud.positions.emplace_back(load_as<float>(record), load_as<float>(record + 4), load_as<float>(record + 8));
        cloud.intensities.push_back(load_as<float>(record + 12));
      });
}

class NuscenesScene final : public Dataset {
 public:
  NuscenesScene(const fs::path& path, const DatasetOptions& options)
      : tables_(nuscenes_tables(path)), root_(tables_.parent_path()), by_azimuth_(options.times_from_azimuth) {
    info_.kind = DatasetKind::nuscenes;
    info_.path = path;
    info_.truth = options.truth;
    const std::string scene = choose_scene(path);
    read_files(scene);
    describe(options);
    streams_.add([this] { return next_scan(); });
    if (!imu_.empty()) streams_.add([this] { return next_sample(); });
  }

  std::optional<Packet> next() override {
    auto packet = streams_.next();
    if (!packet) note_losses();
    return packet;
  }

  std::optional<Trajectory> truth() const override {
    if (info_.truth != ego_poses_) return Dataset::truth();
    std::map<std::string, SE3d> poses;
    for (const SampleData& scan : scans_) poses.try_emplace(scan.ego_pose);
    std::set<std::string> found;
    read_json_table(ego_poses_, [&](const JsonRow& row) {
      const auto pose = poses.find(row.text("token"));
      if (pose == poses.end()) return;
      pose->second = pose_of(row, ego_poses_) * T_ego_body_;
      found.insert(pose->first);
    });
    Trajectory trajectory;
    for (const SampleData& scan : scans_) {
      if (!found.contains(scan.ego_pose)) continue;
      trajectory.times.push_back(scan.time);
      trajectory.poses.push_back(poses[scan.ego_pose]);
    }
    return trajectory;
  }

 private:
  /// The token of the scene that the path names, or of the only one.
  std::string choose_scene(const fs::path& path) {
    std::map<std::string, std::string> scenes;
    std::map<std::string, std::string> logs;
    read_json_table(tables_ / "scene.json", [&](const JsonRow& row) {
      scenes[row.text("name")] = row.text("token");
      logs[row.text("name")] = row.text("log_token");
    });
    if (!fs::exists(path)) {
      info_.name = folder_name(path);
      if (const auto scene = scenes.find(info_.name); scene != scenes.end()) {
        log_ = logs[info_.name];
        return scene->second;
      }
    } else if (scenes.size() == 1) {
      info_.name = scenes.begin()->first;
      log_ = logs[info_.name];
      return scenes.begin()->second;
    }
    std::string names;
    for (const auto& [name, token] : scenes) names += (names.empty() ? "" : ", ") + name;
    throw_input_error(path.string(), "", std::to_string(scenes.size()) + " scenes: " + names,
                      "name one of them as if it were a folder: " + (root_ / "SCENE").string());
  }

  void read_files(const std::string& scene) {
    std::set<std::string> samples;
    read_json_table(tables_ / "sample.json", [&](const JsonRow& row) {
      if (row.text("scene_token") == scene) samples.insert(row.text("token"));
    });
    std::map<std::string, std::string> channels;
    read_json_table(tables_ / "sensor.json", [&](const JsonRow& row) {
      const std::string& channel = row.text("channel");
      channels[row.text("token")] = channel;
      const bool better = lidar_.empty() || channel == "LIDAR_FRONT_CENTER" || channel == "LIDAR_TOP";
      if (row.text("modality") == "lidar" && better) lidar_ = channel;
      if (row.text("modality") == "imu" || channel.starts_with("IMU")) imu_channel_ = channel;
    });
    std::map<std::string, Mounting> mountings;
    const fs::path calibration = tables_ / "calibrated_sensor.json";
    read_json_table(calibration, [&](const JsonRow& row) {
      const std::string& channel = channels[row.text("sensor_token")];
      if (!channel.empty() && (channel == lidar_ || channel == imu_channel_))
        mountings[row.text("token")] = {channel, pose_of(row, calibration)};
    });
    const fs::path table = tables_ / "sample_data.json";
    read_json_table(table, [&](const JsonRow& row) {
      const auto mounting = mountings.find(row.text("calibrated_sensor_token"));
      if (mounting == mountings.end() || !samples.contains(row.text("sample_token"))) return;
      const bool lidar = mounting->second.channel == lidar_;
      (lidar ? scans_ : imu_)
          .push_back({time_of(row, table), root_ / row.text("filename"), row.text("ego_pose_token")});
      (lidar ? T_ego_lidar_ : T_ego_body_) = mounting->second.T_ego_sensor;
    });
    if (scans_.empty())
      throw_input_error(table.string(), "", "no LiDAR scans of the scene " + info_.name,
                        "check that the tables are whole");
    std::ranges::sort(scans_, {}, &SampleData::time);
    std::ranges::sort(imu_, {}, &SampleData::time);
    if (imu_.empty()) T_ego_body_ = T_ego_lidar_;  // body = the LiDAR
  }

  void describe(const DatasetOptions& options) {
    ego_poses_ = tables_ / "ego_pose.json";
    if (info_.truth.empty() && fs::is_regular_file(ego_poses_)) info_.truth = ego_poses_;
    set_extrinsic(options, StatedExtrinsic{T_ego_body_.inverse() * T_ego_lidar_, "calibrated_sensor.json"},
                  !imu_.empty(), info_);
    convert_ = ImuConversion(options);
    info_.start = scans_.front().time;
    info_.end = scans_.back().time;
    info_.sensors.push_back({lidar_, SensorKind::lidar, scans_.size(), "x y z intensity ring, no time per point"});
    if (!imu_.empty()) {
      info_.sensors.push_back({imu_channel_, SensorKind::imu, imu_.size(), "acceleration and rates"});
      info_.sensors.push_back({imu_channel_, SensorKind::gnss, std::nullopt, "its positions; 1 m and 2 m assumed"});
    }
    info_.truth_frame = fs::absolute(root_).lexically_normal().string() + ", " + location();
    find_period();
  }

  /// Scenes of one object share a frame; nuScenes' own object holds several places, each with its frame.
  std::string location() const {
    std::string place;
    if (fs::is_regular_file(tables_ / "log.json"))
      read_json_table(tables_ / "log.json", [&](const JsonRow& row) {
        if (row.text("token") == log_) place = row.text("location");
      });
    return place;
  }

  /// Whether the points' times can be found from their azimuth, by the first scan.
  void find_period() {
    std::vector<Duration> steps;
    for (std::size_t i = 1; i < scans_.size(); ++i) steps.push_back(scans_[i].time - scans_[i - 1].time);
    std::ranges::sort(steps);
    const double step = steps.empty() ? 0 : to_seconds(steps[steps.size() / 2]);
    const bool sweeps = step > 0.02 && step < 0.25;
    std::string why = "times of points are not asked for";
    if (by_azimuth_ && !sweeps)
      why = "scans come every " + text_of(step) + " s, not at every turn";
    else if (by_azimuth_)
      try {
        if (times_by_azimuth(read_nuscenes_cloud(scans_.front().file), step)) period_ = step;
        why = "the points are not in the order in which a turning sensor measures";
      } catch (const IoError&) {
        why = "the first scan cannot be read";
      }
    info_.motion_corrected = !period_;
    info_.notes.push_back(period_ ? "times of points from their azimuth, in turns of " + text_of(step) +
                                        " s that end at the scan's stamp"
                                  : "scans are taken as snapshots: " + why);
  }

  std::optional<Packet> next_scan() {
    while (scan_ < scans_.size()) {
      const SampleData& data = scans_[scan_++];
      try {
        LidarScan scan{.time = data.time, .end = data.time, .cloud = read_nuscenes_cloud(data.file)};
        if (!period_) return scan;
        if (auto times = times_by_azimuth(scan.cloud, *period_)) {
          scan.time = data.time - seconds(*period_);
          scan.cloud.time_offsets = std::move(*times);
        } else {
          ++unsteady_;
        }
        return scan;
      } catch (const IoError& error) {
        lost_.add(error);
      }
    }
    return std::nullopt;
  }

  /// The next sample of the IMU; behind it its fix, if it has one.
  std::optional<Packet> next_sample() {
    if (fix_) return std::exchange(fix_, std::nullopt);
    while (sample_ < imu_.size()) {
      const SampleData& data = imu_[sample_++];
      std::optional<ImuSample> sample;
      try {
        read_json_table(data.file, [&](const JsonRow& row) { sample = take(row, data.time); });
      } catch (const IoError& error) {
        lost_.add(error);
        continue;
      }
      if (sample) return *sample;
      ++incomplete_;
    }
    return std::nullopt;
  }

  std::optional<ImuSample> take(const JsonRow& row, Timestamp time) {
    const auto* rate = row.find("avel", 3);
    const auto* force = row.find("acc", 3);
    if (rate == nullptr || force == nullptr) return std::nullopt;
    const ImuSample sample = convert_({.time = time,
                                       .gyro = Eigen::Vector3d((*rate)[0], (*rate)[1], (*rate)[2]),
                                       .accel = Eigen::Vector3d((*force)[0], (*force)[1], (*force)[2])});
    const auto *latitude = row.find("lat", 1), *longitude = row.find("lon", 1), *height = row.find("elev", 1);
    if (height != nullptr) altitude_ = (*height)[0];
    if (latitude != nullptr && longitude != nullptr && altitude_) {
      const GeodeticPosition position{(*latitude)[0], (*longitude)[0], *altitude_};
      const GnssDeviation deviation{.horizontal = 1, .vertical = height == nullptr ? 50.0 : 2.0};
      if (plausible(position))
        fix_ = make_fix(sample.time, position, deviation,
                        height == nullptr ? GnssQuality::two_dimensional : GnssQuality::three_dimensional);
    }
    return sample;
  }

  void note_losses() {
    if (std::exchange(noted_, true)) return;
    if (std::string loss = lost_.sentence(); !loss.empty()) info_.warnings.push_back(std::move(loss));
    if (incomplete_ > 0)
      info_.warnings.push_back(std::to_string(incomplete_) + " files of " + imu_channel_ + " without avel and acc");
    if (unsteady_ > 0)
      info_.warnings.push_back(std::to_string(unsteady_) + " scans do not turn steadily: they have no times of points");
    if (streams_.dropped() > 0)
      info_.warnings.push_back(std::to_string(streams_.dropped()) + " packets dropped that went back in time");
  }

  fs::path tables_, root_, ego_poses_;
  bool by_azimuth_;
  std::string lidar_, imu_channel_, log_;
  std::vector<SampleData> scans_, imu_;
  SE3d T_ego_lidar_, T_ego_body_;
  std::optional<double> period_;  ///< seconds of a turn, where times are found by azimuth
  MergedStreams streams_;
  std::size_t scan_ = 0, sample_ = 0;
  std::optional<Packet> fix_;
  ImuConversion convert_;
  std::optional<double> altitude_;
  LeftOut lost_;
  std::size_t incomplete_ = 0, unsteady_ = 0;
  bool noted_ = false;
};

}  // namespace

fs::path nuscenes_tables(const fs::path& path) {
  const fs::path whole = fs::absolute(path / "").lexically_normal();
  for (const fs::path& place : {path, whole.parent_path().parent_path()}) {
    std::error_code missing;
    std::vector<fs::path> found;
    for (const auto& entry : fs::directory_iterator(place, missing))
      if (entry.path().filename().string().starts_with("v1.0") && fs::is_regular_file(entry.path() / "scene.json") &&
          fs::is_regular_file(entry.path() / "sample_data.json"))
        found.push_back(entry.path());
    if (!found.empty()) return *std::ranges::min_element(found);
    if (fs::exists(path)) return {};  // a scene's name is no folder
  }
  return {};
}

std::unique_ptr<Dataset> open_nuscenes(const fs::path& path, const DatasetOptions& options) {
  return std::make_unique<NuscenesScene>(path, options);
}

}  // namespace chainslam::datasets
