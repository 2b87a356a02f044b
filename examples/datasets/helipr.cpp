#include "datasets/helipr.hpp"

#include <algorithm>
#include <array>
#include <memory>
#include <span>
#include <string>
#include <utility>

#include "chainslam/core/byte_archive.hpp"
#include "chainslam/core/error.hpp"
#include "chainslam/io/detail/point_records.hpp"
#include "datasets/extrinsic.hpp"
#include "datasets/files.hpp"
#include "datasets/geodesy.hpp"
#include "datasets/mulran.hpp"
#include "datasets/number_rows.hpp"
#include "datasets/ouster.hpp"
#include "datasets/pose_table.hpp"
#include "datasets/scan_files.hpp"

// HeLiPR (Jung et al. 2024): LiDAR/<sensor>/<ns>.bin, one record layout for each of four sensors; Inertial_data with
// inspva.csv (ns, lat, lon, height, vN, vE, vU, roll, pitch, azimuth, status) and xsens_imu.csv as MulRan's;
// LiDAR_GT/global_<sensor>_gt.txt or <sensor>_gt.txt (ns x y z qx qy qz qw, of that sensor).

namespace chainslam::datasets {
namespace {

namespace fs = std::filesystem;

/// How a sensor's records are laid out: x y z as floats in front, then what is named here.
struct RecordLayout {
  std::string_view sensor;
  std::size_t stride = 0;
  std::size_t intensity = 12;      ///< byte of it, ...
  bool intensity_is_float = true;  ///< ... which is a float or a byte
  std::size_t time = 0;            ///< byte of the time since the scan's start, ...
  bool time_is_float = false;      ///< ... seconds as a float, or nanoseconds as 32 bits
};

constexpr std::array<RecordLayout, 4> layouts{{
    {.sensor = "Ouster", .stride = 26, .time = 16},
    {.sensor = "Velodyne", .stride = 22, .time = 18, .time_is_float = true},
    {.sensor = "Aeva", .stride = 25, .time = 20},  // 29 with an intensity behind, from `aeva_intensity` on
    {.sensor = "Avia", .stride = 19, .intensity = 12, .intensity_is_float = false, .time = 15},
}};
constexpr std::int64_t aeva_intensity = 1'691'936'557'946'849'179;

const RecordLayout& layout_of(const fs::path& folder) {
  return *std::ranges::find(layouts, folder.filename().string(), &RecordLayout::sensor);
}

LidarScan read_scan(const fs::path& path, const RecordLayout& layout, Timestamp stamp) {
  const bool longer = layout.sensor == "Aeva" && stamp.nanoseconds() > aeva_intensity;
  const std::size_t stride = layout.stride + (longer ? 4 : 0);
  std::vector<double> times;
  LidarScan scan{.time = stamp, .end = stamp, .cloud = {}};
  scan.cloud = detail::read_point_records(
      path, stride,
      "HeLiPR's " + std::string(layout.sensor) + " scans hold " + std::to_string(stride) + " bytes a point",
      [&](const std::byte* record, PointCloud<float>& cloud) {
        cloud.positions.emplace_back(load_as<float>(record), load_as<float>(record + 4), load_as<float>(record + 8));
        const std::byte* strength = record + layout.intensity;
        cloud.intensities.push_back(layout.intensity_is_float ? load_as<float>(strength)
                                                              : static_cast<float>(load_as<std::uint8_t>(strength)));
        const std::byte* time = record + layout.time;
        times.push_back(layout.time_is_float ? static_cast<double>(load_as<float>(time)) * 1e9
                                             : static_cast<double>(load_as<std::int32_t>(time)));
      });
  if (scan.cloud.empty()) return scan;
  set_point_times(scan, {.unit = TimeUnit::nanoseconds}, times, stamp, path);
  return scan;
}

/// The release's calibration between the Xsens and the Ouster.
SE3d T_imu_ouster() {
  Eigen::Matrix3d R;
  R << 0.999715495593027, 0.0223448061210468, -0.00834490926264448,  //
      -0.0224514077723064, 0.999664614804883, -0.0129070599303583,   //
      0.00805370475188661, 0.0130907427756056, 0.999881878170293;
  return SE3d(SO3d::from_matrix(R), {-0.41696532, -0.00301141, 0.2996});
}

fs::path find_truth(const fs::path& path, const std::string& sensor) {
  for (const std::string& name : {"LiDAR_GT/global_" + sensor + "_gt.txt", "LiDAR_GT/" + sensor + "_gt.txt"})
    if (fs::is_regular_file(path / name)) return path / name;
  return {};
}

}  // namespace

fs::path helipr_scans(const fs::path& path, const std::string& sensor) {
  for (const RecordLayout& layout : layouts)
    if (sensor.empty() || sensor == layout.sensor)
      if (const fs::path folder = path / "LiDAR" / layout.sensor; !files_in(folder, {".bin"}).empty()) return folder;
  return {};
}

std::unique_ptr<Dataset> open_helipr(const fs::path& path, const DatasetOptions& options) {
  const fs::path folder = helipr_scans(path, options.lidar_topic);
  if (folder.empty())
    throw_input_error((path / "LiDAR").string(), "", "no scans of " + options.lidar_topic,
                      "name a LiDAR that is there: " + contents_of(path / "LiDAR"));
  const RecordLayout& layout = layout_of(folder);
  const std::string sensor(layout.sensor);
  const std::vector<fs::path> files = files_in(folder, {".bin"});
  const std::vector<Timestamp> times = times_of_names(files);
  ScanFiles parts =
      scans_of(DatasetKind::helipr, path, {sensor, SensorKind::lidar, files.size(), "times of points as stored"},
               times.front(), times.back());
  DatasetInfo& info = parts.info;
  info.notes.push_back("LiDARs that are there: " + contents_of(path / "LiDAR") + "; read: " + sensor);
  parts.read = [=](std::size_t i) { return read_scan(files[i], layout, times[i]); };
  add_xsens(parts, options, path / "Inertial_data/xsens_imu.csv");
  const bool inertial = !parts.others.empty();
  auto stated = find_extrinsic({path});
  if (inertial && !stated && sensor == "Ouster") stated = {T_imu_ouster(), "the release's calibration"};
  set_extrinsic(options, stated, inertial, info);
  if (const fs::path ins = path / "Inertial_data/inspva.csv"; fs::is_regular_file(ins)) {
    info.sensors.push_back({"inspva.csv", SensorKind::gnss, std::nullopt, "positions of an INS; 1 m and 2 m assumed"});
    const auto rows = std::make_shared<NumberRows>(ins, 3, TimeUnit::nanoseconds);
    parts.others.push_back([rows]() -> std::optional<Packet> {
      while (const auto row = rows->next()) {
        const GeodeticPosition position{row->second[0], row->second[1], row->second[2]};
        if (plausible(position)) return make_fix(row->first, position, {1, 2}, GnssQuality::differential);
      }
      return std::nullopt;
    });
    parts.end.push_back([rows] { return rows->cut(); });
  }
  const fs::path poses = find_truth(path, sensor);
  info.truth_frame = "HeLiPR";
  set_truth(parts, options, poses, [poses, T_lidar_body = info.T_body_lidar.inverse()] {
    Trajectory truth = read_pose_table(
        poses, ' ', [](LineFields& fields) { return time_field(fields, TimeUnit::nanoseconds); },
        read_position_and_quaternion);
    for (SE3d& pose : truth.poses) pose = pose * T_lidar_body;
    return truth;
  });
  return dataset_of(std::move(parts));
}

}  // namespace chainslam::datasets
