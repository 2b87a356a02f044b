#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <numbers>
#include <string>
#include <utility>

#include "chainslam/core/error.hpp"
#include "chainslam/io/detail/text.hpp"
#include "chainslam/io/input_file.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "datasets/extrinsic.hpp"
#include "datasets/files.hpp"
#include "datasets/geodesy.hpp"
#include "datasets/imu_conversion.hpp"
#include "datasets/scan_files.hpp"

// A drive of KITTI's raw recordings (Geiger et al. 2013): velodyne_points/data/NNNNNNNNNN.bin (or .txt, in `extract`)
// with timestamps_start.txt and timestamps_end.txt, oxts/data/NNNNNNNNNN.txt with timestamps.txt, and in the day's
// folder or the drive's calib_imu_to_velo.txt. File N belongs to line N, from 0, of the stamps. The sensor turns
// clockwise from behind, and its points are not corrected for motion. The INS gives samples, fixes and, smoothed, the
// truth.

namespace chainslam::datasets {
namespace {

namespace fs = std::filesystem;

/// Files named by their number, with it.
struct NumberedFiles {
  std::vector<fs::path> files;
  std::vector<std::size_t> numbers;
};

/// @throws IoError naming a file that has no stamp.
NumberedFiles numbered_files(const fs::path& folder, const std::vector<std::string_view>& extensions,
                             std::size_t stamps) {
  NumberedFiles found{files_in(folder, extensions), {}};
  for (const fs::path& file : found.files) {
    const auto number = detail::parse_integer(file.stem().string());
    if (!number || *number < 0 || static_cast<std::size_t>(*number) >= stamps)
      throw_input_error(file.string(), "",
                        "no line of the stamps belongs to it, of which there are " + std::to_string(stamps),
                        "files are named by the number of their line, from 0");
    found.numbers.push_back(static_cast<std::size_t>(*number));
  }
  return found;
}

/// Rows of x y z reflectance.
PointCloud<float> read_text_cloud(const fs::path& path) {
  InputFile file(path);
  PointCloud<float> cloud;
  while (const auto line = file.read_line()) {
    LineFields fields(file, *line);
    if (!fields.more()) continue;
    Eigen::Vector3f position;
    for (int axis = 0; axis < 3; ++axis) position[axis] = static_cast<float>(fields.number("x y z"));
    cloud.positions.push_back(position);
    cloud.intensities.push_back(static_cast<float>(fields.number("reflectance")));
    fields.end("four numbers: x y z reflectance");
  }
  return cloud;
}

/// When a sensor that turns clockwise from behind, once in `sweep` seconds, has measured each point.
std::vector<float> times_in_turn(const PointCloud<float>& cloud, double sweep) {
  std::vector<float> times;
  times.reserve(cloud.size());
  for (const Eigen::Vector3f& p : cloud.positions) {
    const double azimuth = std::atan2(static_cast<double>(p.y()), static_cast<double>(p.x()));
    const double part = 0.5 * (1 - azimuth / std::numbers::pi);
    times.push_back(static_cast<float>(part >= 0 && part <= 1 ? sweep * part : 0.0));
  }
  return times;
}

/// What we take of the 30 numbers of an OXTS record.
struct OxtsRecord {
  GeodeticPosition position;
  SO3d R_enu_body;  ///< body x forward, y left, z up
  Eigen::Vector3d accel, gyro;
  double deviation = 0;  ///< of the position, metres, as the INS states it
  int mode = 0;          ///< of the position: below 3 no fix, 4 differential, 5 and 6 RTK
};

OxtsRecord read_oxts(const fs::path& path) {
  InputFile file(path);
  const auto line = file.read_line();
  if (!line) file.fail("", "an empty file", "copy it again");
  LineFields fields(file, *line);
  std::array<double, 30> v{};
  for (double& value : v) value = fields.number("oxts");
  fields.end("30 numbers, of latitude to orimode");
  const SO3d R = SO3d::exp(v[5] * Eigen::Vector3d::UnitZ()) * SO3d::exp(v[4] * Eigen::Vector3d::UnitY()) *
                 SO3d::exp(v[3] * Eigen::Vector3d::UnitX());
  return {.position = {v[0], v[1], v[2]},
          .R_enu_body = R,
          .accel = {v[11], v[12], v[13]},
          .gyro = {v[17], v[18], v[19]},
          .deviation = v[23],
          .mode = static_cast<int>(std::clamp(v[27], 0.0, 255.0))};
}

/// The records in the order of their numbers: a sample of each, then its fix.
class OxtsStream {
 public:
  OxtsStream(NumberedFiles records, std::vector<Timestamp> times, const ImuConversion& convert)
      : records_(std::move(records)), times_(std::move(times)), convert_(convert) {}

  std::optional<Packet> next() {
    if (fix_) return std::exchange(fix_, std::nullopt);
    while (record_ < records_.files.size()) try {
        const std::size_t i = record_++;
        return packet(read_oxts(records_.files[i]), times_[records_.numbers[i]]);
      } catch (const IoError& error) {
        lost_.add(error);
      }
    return std::nullopt;
  }

  [[nodiscard]] std::string losses() const { return lost_.sentence(); }

  /// T_map_body: east, north, up about the first record.
  [[nodiscard]] Trajectory truth() const {
    Trajectory trajectory;
    std::optional<GeodeticPosition> origin;
    for (std::size_t i = 0; i < records_.files.size(); ++i) {
      const Timestamp time = times_[records_.numbers[i]];
      OxtsRecord record;
      try {
        record = read_oxts(records_.files[i]);
      } catch (const IoError&) {
        continue;  // left out, as `next` says
      }
      if (!plausible(record.position) || (!trajectory.empty() && time < trajectory.times.back())) continue;
      if (!origin) origin = record.position;
      trajectory.times.push_back(time);
      trajectory.poses.push_back(SE3d(record.R_enu_body, east_north_up(*origin, record.position)));
    }
    return trajectory;
  }

 private:
  ImuSample packet(const OxtsRecord& record, Timestamp time) {
    const ImuSample sample = convert_({.time = time, .gyro = record.gyro, .accel = record.accel});
    if (record.mode >= 3 && record.deviation > 0 && plausible(record.position)) {
      const GnssQuality quality = record.mode == 4   ? GnssQuality::differential
                                  : record.mode == 5 ? GnssQuality::rtk_float
                                  : record.mode == 6 ? GnssQuality::rtk_fixed
                                                     : GnssQuality::three_dimensional;
      fix_ = make_fix(sample.time, record.position, {record.deviation, 2 * record.deviation}, quality);
    }
    return sample;
  }

  NumberedFiles records_;
  std::vector<Timestamp> times_;
  ImuConversion convert_;
  LeftOut lost_;
  std::size_t record_ = 0;
  std::optional<Packet> fix_;
};

/// The drive's folder, and its day's.
std::vector<fs::path> places_of_calibration(const fs::path& path) {
  return {path, fs::absolute(path / "").lexically_normal().parent_path().parent_path()};
}

struct SweepStamps {
  std::vector<Timestamp> start, end;
};

/// @throws IoError if starts and ends are not equally many, or a sweep ends before it starts or lasts over a second.
SweepStamps sweep_stamps(const fs::path& velodyne) {
  SweepStamps stamps;
  if (fs::is_regular_file(velodyne / "timestamps_start.txt")) {
    stamps = {read_stamps(velodyne / "timestamps_start.txt"), read_stamps(velodyne / "timestamps_end.txt")};
  } else {  // the time at which it looks ahead
    for (const Timestamp middle : read_stamps(velodyne / "timestamps.txt")) {
      stamps.start.push_back(middle - std::chrono::milliseconds(50));
      stamps.end.push_back(middle + std::chrono::milliseconds(50));
    }
  }
  bool whole = stamps.start.size() == stamps.end.size();
  for (std::size_t i = 0; whole && i < stamps.start.size(); ++i)
    whole = stamps.end[i] >= stamps.start[i] && stamps.end[i] - stamps.start[i] < std::chrono::seconds(1);
  if (!whole)
    throw_input_error(velodyne.string(), "", "starts and ends of sweeps that do not belong together",
                      "copy timestamps_start.txt and timestamps_end.txt again");
  return stamps;
}

}  // namespace

std::unique_ptr<Dataset> open_kitti_raw(const fs::path& path, const DatasetOptions& options) {
  const fs::path velodyne = path / "velodyne_points";
  const SweepStamps stamps = sweep_stamps(velodyne);
  const NumberedFiles scans = numbered_files(velodyne / "data", {".bin", ".txt"}, stamps.start.size());
  if (scans.files.empty())
    throw_input_error((velodyne / "data").string(), "", "no scans", "put the drive's scans there");
  ScanFiles parts = scans_of(DatasetKind::kitti_raw, path,
                             {"velodyne_points", SensorKind::lidar, scans.files.size(), "times of points by azimuth"},
                             stamps.start[scans.numbers.front()], stamps.end[scans.numbers.back()]);
  DatasetInfo& info = parts.info;
  info.truth = options.truth;
  parts.read = [=](std::size_t i) {
    const fs::path& file = scans.files[i];
    const Timestamp start = stamps.start[scans.numbers[i]], end = stamps.end[scans.numbers[i]];
    LidarScan scan{
        .time = start, .end = end, .cloud = file.extension() == ".bin" ? read_kitti_bin(file) : read_text_cloud(file)};
    scan.cloud.time_offsets = times_in_turn(scan.cloud, to_seconds(end - start));
    return scan;
  };
  if (fs::is_directory(path / "oxts")) {
    const std::vector<Timestamp> times = read_stamps(path / "oxts/timestamps.txt", false);
    const auto oxts = std::make_shared<OxtsStream>(numbered_files(path / "oxts/data", {".txt"}, times.size()), times,
                                                   ImuConversion(options));
    info.sensors.push_back({"oxts", SensorKind::imu, times.size(), "forward, left, up"});
    info.sensors.push_back(
        {"oxts", SensorKind::gnss, std::nullopt, "positions of the INS, with the deviation it states"});
    info.p_body_antenna = Eigen::Vector3d::Zero();
    info.notes.emplace_back("truth: the poses of the same INS that gives samples and fixes");
    parts.others.push_back([oxts] { return oxts->next(); });
    parts.end.push_back([oxts] { return oxts->losses(); });
    set_truth(parts, options, path / "oxts", [oxts] { return oxts->truth(); });
    set_extrinsic(options, find_extrinsic(places_of_calibration(path)), true, info);
  } else {
    set_extrinsic(options, std::nullopt, false, info);
  }
  return dataset_of(std::move(parts));
}

}  // namespace chainslam::datasets
