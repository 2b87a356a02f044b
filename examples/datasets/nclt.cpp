#include "datasets/nclt.hpp"

#include <algorithm>
#include <numbers>
#include <string>
#include <system_error>
#include <utility>

#include "chainslam/core/types.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "datasets/dataset.hpp"
#include "datasets/extrinsic.hpp"
#include "datasets/files.hpp"
#include "datasets/geodesy.hpp"
#include "datasets/ground_check.hpp"
#include "datasets/imu_conversion.hpp"
#include "datasets/merged_streams.hpp"
#include "datasets/number_rows.hpp"
#include "datasets/scan_files.hpp"

// NCLT (Carlevaris-Bianco, Ushani and Eustice 2016). A folder holds, side by side or in the release's own folders
// velodyne_data/<date>, sensor_data/<date> and ground_truth:
//   velodyne_hits.bin and/or velodyne_sync/<utime>.bin, ms25.csv, gps.csv, gps_rtk.csv, groundtruth*.csv or *.tum.
// Our body frame is the inertial unit's, turned to x forward, y left, z up; our map frame is x north, y west, z up.

namespace chainslam::datasets {
namespace {

constexpr double degrees_per_radian = 180 / std::numbers::pi;

/// utime, magnetometer x y z, accelerometer x y z, rates r p h.
class ImuFile {
 public:
  explicit ImuFile(const std::filesystem::path& path)
      : rows_(path, 9, TimeUnit::microseconds, "utime and nine numbers") {}

  std::optional<ImuSample> next() {
    while (const auto row = rows_.next()) {
      const auto& values = row->second;
      if (!all_finite(values.subspan(3))) {
        ++skipped_;
        continue;
      }
      return ImuSample{
          .time = row->first, .gyro = {values[6], values[7], values[8]}, .accel = {values[3], values[4], values[5]}};
    }
    return std::nullopt;
  }

  [[nodiscard]] std::size_t skipped() const { return skipped_; }
  [[nodiscard]] const std::string& cut() const { return rows_.cut(); }

 private:
  NumberRows rows_;
  std::size_t skipped_ = 0;
};

/// utime, mode, satellites, latitude, longitude (rad), altitude (m, may be NaN), track, speed.
class GnssFile {
 public:
  GnssFile(const std::filesystem::path& path, bool rtk)
      : rows_(path, 7, TimeUnit::microseconds, "utime and seven numbers"), rtk_(rtk) {}

  std::optional<GnssFix> next() {
    while (const auto row = rows_.next()) {
      const auto& values = row->second;
      const GeodeticPosition position{values[2] * degrees_per_radian, values[3] * degrees_per_radian, values[4]};
      if (is_finite(values[4])) altitude_ = values[4];
      const bool flat = values[0] == 2 || !is_finite(values[4]);
      if (!(values[0] >= 2) || !altitude_) continue;
      const GeodeticPosition usable{position.latitude_deg, position.longitude_deg, *altitude_};
      if (!plausible(usable)) continue;
      return make_fix(row->first, usable, deviation(flat),
                      flat   ? GnssQuality::two_dimensional
                      : rtk_ ? GnssQuality::differential
                             : GnssQuality::three_dimensional);
    }
    return std::nullopt;
  }

  [[nodiscard]] const std::string& cut() const { return rows_.cut(); }

 private:
  /// The files state none: what such receivers keep to in streets. A flat fix has the last height known.
  [[nodiscard]] GnssDeviation deviation(bool flat) const {
    const double horizontal = rtk_ ? 0.5 : 3;
    return {.horizontal = horizontal, .vertical = flat ? 50 : 2 * horizontal};
  }

  NumberRows rows_;
  bool rtk_;
  std::optional<double> altitude_;
};

/// Where a session's files are.
struct Layout {
  std::filesystem::path hits, imu, gps, gps_rtk, truth, calibration;
  std::vector<std::filesystem::path> sync;
};

/// The folder itself and, where it is the release's own tree with one date, the folders in it.
std::vector<std::filesystem::path> places(const std::filesystem::path& path) {
  std::vector<std::filesystem::path> found{path};
  for (const char* part : {"velodyne_data", "sensor_data", "ground_truth"}) {
    std::vector<std::filesystem::path> dates;
    std::error_code missing;
    for (const auto& entry : std::filesystem::directory_iterator(path / part, missing))
      if (entry.is_directory()) dates.push_back(entry.path());
    if (dates.size() > 1)
      throw_input_error((path / part).string(), "", std::to_string(dates.size()) + " sessions",
                        "put the files of one session into a folder and name that");
    if (std::filesystem::is_directory(path / part)) found.push_back(path / part);
    found.insert(found.end(), dates.begin(), dates.end());
  }
  return found;
}

std::filesystem::path truth_among(const std::vector<std::filesystem::path>& files) {
  const auto named = [&](auto&& wanted) {
    const auto file = std::ranges::find_if(files, [&](const auto& p) { return wanted(p.filename().string()); });
    return file == files.end() ? std::filesystem::path() : *file;
  };
  auto csv = named([](const std::string& n) { return n.starts_with("groundtruth") && n.ends_with(".csv"); });
  if (!csv.empty()) return csv;
  return named([](const std::string& n) {
    return n.ends_with(".tum") && (n.find("gt") != n.npos || n.find("truth") != n.npos);
  });
}

Layout find_files(const std::filesystem::path& path) {
  Layout layout;
  for (const std::filesystem::path& place : places(path)) {
    const auto take = [&](std::filesystem::path& slot, const char* name) {
      if (slot.empty() && std::filesystem::is_regular_file(place / name)) slot = place / name;
    };
    take(layout.hits, "velodyne_hits.bin");
    take(layout.imu, "ms25.csv");
    take(layout.gps, "gps.csv");
    take(layout.gps_rtk, "gps_rtk.csv");
    take(layout.calibration, "calib.txt");
    if (layout.sync.empty()) layout.sync = files_in(place / "velodyne_sync", {".bin"});
    if (layout.truth.empty()) layout.truth = truth_among(files_in(place, {".csv", ".tum"}));
  }
  return layout;
}

class Nclt final : public Dataset {
 public:
  Nclt(const std::filesystem::path& path, const DatasetOptions& options) : layout_(find_files(path)) {
    info_.kind = DatasetKind::nclt;
    info_.path = path;
    info_.name = folder_name(path);
    info_.truth = options.truth.empty() ? layout_.truth : options.truth;
    info_.truth_frame = "NCLT";
    if (!layout_.hits.empty() && !(options.prefer_sync && !layout_.sync.empty()))
      open_hits();
    else
      open_sync();
    choose_axes(options);
    find_mounting(options);
    streams_.add([this] { return next_scan(); });
    if (!layout_.imu.empty()) open_imu(options);
    open_gnss(options.gnss);
  }

  std::optional<Packet> next() override {
    auto packet = streams_.next();
    if (!packet) note_losses();
    return packet;
  }

  std::optional<Trajectory> truth() const override {
    if (info_.truth.extension() == ".csv") return read_nclt_ground_truth(info_.truth);
    return Dataset::truth();
  }

 private:
  void open_hits() {
    sweeps_.emplace(layout_.hits);
    info_.sensors.push_back({layout_.hits.filename().string(), SensorKind::lidar, std::nullopt,
                             "sweeps cut behind the sensor, time of each point by its packet"});
    if (sweeps_->ahead()) info_.start = sweeps_->ahead()->time;
    if (!layout_.sync.empty()) info_.notes.emplace_back("velodyne_sync is there too; the raw hits were preferred");
  }

  void open_sync() {
    if (layout_.sync.empty())
      throw_input_error(info_.path.string(), "", "neither velodyne_hits.bin nor files in velodyne_sync",
                        "put the session's LiDAR data beside its other files");
    for (const auto& file : layout_.sync)
      if (!time_of_name(file.stem().string()))
        throw_input_error(file.string(), "", "a name that is no time", "scans are named by microseconds since 1970");
    info_.motion_corrected = true;
    info_.start = time_of_name(layout_.sync.front().stem().string());
    info_.end = time_of_name(layout_.sync.back().stem().string());
    info_.sensors.push_back({"velodyne_sync", SensorKind::lidar, layout_.sync.size(),
                             "snapshots: corrected for motion by whoever made them"});
  }

  /// Turns NCLT's axes to z up, unless the options or, in an automatic choice, the ground says that they are so
  /// already.
  void choose_axes(const DatasetOptions& options) {
    flipped_ = options.axes != NcltAxes::kitti;
    const GroundCheck ground = look_for_ground();
    const bool wrong = ground.side == GroundSide::above;
    if (wrong && options.axes == NcltAxes::automatic && !layout_.calibration.empty()) {
      flipped_ = false;
      info_.notes.emplace_back(
          "calib.txt lies beside the scans and the ground is below with z up: axes taken as KITTI's, x forward, y "
          "left, "
          "z up");
    } else if (wrong) {
      info_.warnings.push_back(
          std::string("the densest level plane is above the sensor: axes look wrong; set the axes to ") +
          (flipped_ ? "kitti" : "nclt"));
    }
    if (flipped_) info_.notes.emplace_back("axes turned from NCLT's z down to x forward, y left, z up");
  }

  [[nodiscard]] GroundCheck look_for_ground() const {
    std::optional<LidarScan> scan;
    if (sweeps_)
      scan = NcltSweeps(layout_.hits).next();
    else
      scan = LidarScan{.time = {}, .end = {}, .cloud = read_nclt_sync(layout_.sync.front())};
    if (!scan) return {};
    flip(scan->cloud);
    return find_ground(scan->cloud);
  }

  void flip(PointCloud<float>& cloud) const {
    if (!flipped_) return;
    for (Eigen::Vector3f& p : cloud.positions) p = {p.x(), -p.y(), -p.z()};
  }

  [[nodiscard]] Eigen::Vector3d flip(const Eigen::Vector3d& v) const {
    return flipped_ ? Eigen::Vector3d(v.x(), -v.y(), -v.z()) : v;
  }

  /// By the release, for its own axes.
  void find_mounting(const DatasetOptions& options) {
    auto stated = find_extrinsic({info_.path});
    if (!stated && flipped_)
      stated = {half_turn_about_x() * nclt_T_body_imu().inverse() * nclt_T_body_velodyne() * half_turn_about_x(),
                "the release's calibration"};
    set_extrinsic(options, stated, !layout_.imu.empty(), info_);
  }

  void open_imu(const DatasetOptions& options) {
    imu_.emplace(layout_.imu);
    info_.sensors.push_back({"ms25.csv", SensorKind::imu, std::nullopt, ""});
    constexpr std::size_t most = 20'000;  // samples that say what the units are
    std::vector<ImuSample> beginning;
    ImuFile file(layout_.imu);
    while (beginning.size() < most) {
      const auto sample = file.next();
      if (!sample) break;
      beginning.push_back(*sample);
    }
    const ImuConversion convert(options, beginning, info_);
    Eigen::Vector3d sum = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < std::min<std::size_t>(beginning.size(), 100); ++i) sum += flip(beginning[i].accel);
    if (sum.z() < -0.5 * sum.norm())
      info_.warnings.emplace_back("ms25.csv: at the start the specific force points down: its axes look turned over");
    ordered_imu_.emplace([this] { return imu_->next(); });
    streams_.add([this, convert]() -> std::optional<Packet> {
      auto sample = ordered_imu_->next();
      if (!sample) return std::nullopt;
      sample->gyro = flip(sample->gyro);
      sample->accel = flip(sample->accel);
      return convert(*sample);
    });
  }

  void open_gnss(NcltGnss choice) {
    if (choice == NcltGnss::none) return;
    const bool rtk = !layout_.gps_rtk.empty() && choice != NcltGnss::consumer;
    const std::filesystem::path& file = rtk ? layout_.gps_rtk : layout_.gps;
    if (file.empty() || (choice == NcltGnss::rtk && !rtk)) return;
    gnss_.emplace(file, rtk);
    info_.sensors.push_back({file.filename().string(), SensorKind::gnss, std::nullopt,
                             rtk ? "0.5 m and 1 m assumed" : "3 m and 6 m assumed"});
    const Eigen::Vector3d antenna = rtk ? Eigen::Vector3d(-0.24, 0, -1.24) : Eigen::Vector3d(0, 0.25, -0.51);
    if (flipped_) info_.p_body_antenna = half_turn_about_x() * (nclt_T_body_imu().inverse() * antenna);
    streams_.add([this]() -> std::optional<Packet> {
      const auto fix = gnss_->next();
      return fix ? std::optional<Packet>(*fix) : std::nullopt;
    });
  }

  std::optional<Packet> next_scan() {
    std::optional<LidarScan> scan = sweeps_ ? sweeps_->next() : next_sync();
    if (!scan) return std::nullopt;
    flip(scan->cloud);
    return std::move(*scan);
  }

  std::optional<LidarScan> next_sync() {
    while (scan_ < layout_.sync.size()) try {
        const std::filesystem::path& file = layout_.sync[scan_++];
        const Timestamp time = *time_of_name(file.stem().string());
        return LidarScan{.time = time, .end = time, .cloud = read_nclt_sync(file)};
      } catch (const IoError& error) {
        lost_.add(error);
      }
    return std::nullopt;
  }

  /// At the end of the data: what was left out on the way.
  void note_losses() {
    if (std::exchange(noted_, true)) return;
    for (std::string loss : {lost_.sentence(), imu_ ? imu_->cut() : "", gnss_ ? gnss_->cut() : ""})
      if (!loss.empty()) info_.warnings.push_back(std::move(loss));
    if (sweeps_ && !sweeps_->damage().empty()) info_.warnings.push_back("velodyne_hits.bin, " + sweeps_->damage());
    const auto note = [&](std::size_t count, const char* what) {
      if (count > 0) info_.warnings.push_back(std::to_string(count) + what);
    };
    note(streams_.dropped(), " packets dropped that went back in time");
    if (sweeps_) note(sweeps_->backward(), " packets of velodyne_hits.bin earlier than the one before");
    if (sweeps_ && sweeps_->dropped() > 0)
      info_.notes.push_back(std::to_string(sweeps_->dropped()) + " sweeps of less than half a turn left out");
    if (imu_) note(imu_->skipped(), " rows of ms25.csv skipped that hold no number");
    if (ordered_imu_) note(ordered_imu_->dropped(), " rows of ms25.csv left out whose time is ahead of the next row's");
  }

  Layout layout_;
  bool flipped_ = true;
  std::optional<NcltSweeps> sweeps_;
  std::size_t scan_ = 0;
  LeftOut lost_;  ///< files of velodyne_sync
  std::optional<ImuFile> imu_;
  std::optional<TimesThatRunOn> ordered_imu_;
  std::optional<GnssFile> gnss_;
  MergedStreams streams_;
  bool noted_ = false;
};

}  // namespace

Trajectory read_nclt_ground_truth(const std::filesystem::path& path) {
  NumberRows rows(path, 6, TimeUnit::microseconds, "utime and six numbers");
  const SE3d flip = half_turn_about_x();
  Trajectory trajectory;
  while (const auto row = rows.next()) {
    const auto& v = row->second;
    if (!all_finite(v)) continue;
    if (!trajectory.times.empty() && row->first < trajectory.times.back())
      throw_input_error(path.string(), "utime " + std::to_string(row->first.nanoseconds() / 1000),
                        "a time that is earlier than the one before it", "sort the rows by time");
    const SO3d R = SO3d::exp(v[5] * Eigen::Vector3d::UnitZ()) * SO3d::exp(v[4] * Eigen::Vector3d::UnitY()) *
                   SO3d::exp(v[3] * Eigen::Vector3d::UnitX());
    const SE3d T_ned_base(R, {v[0], v[1], v[2]});
    trajectory.times.push_back(row->first);
    trajectory.poses.push_back(flip * T_ned_base * nclt_T_body_imu() * flip);
  }
  return trajectory;
}

std::unique_ptr<Dataset> open_nclt(const std::filesystem::path& path, const DatasetOptions& options) {
  return std::make_unique<Nclt>(path, options);
}

}  // namespace chainslam::datasets
