#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <string>
#include <utility>

#include "chainslam/core/error.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "datasets/extrinsic.hpp"
#include "datasets/files.hpp"
#include "datasets/geodesy.hpp"
#include "datasets/imu_table.hpp"
#include "datasets/mulran.hpp"
#include "datasets/number_rows.hpp"
#include "datasets/ouster.hpp"
#include "datasets/pose_table.hpp"
#include "datasets/scan_files.hpp"

// MulRan (Kim et al. 2020): Ouster/<ns>.bin or sensor_data/Ouster/<ns>.bin, records of x y z intensity, column by
// column of an OS1-64 that turns at 10 Hz; beside them or beside sensor_data global_pose.csv (ns, T_utm_base as 3x4),
// gps.csv (ns, lat, lon, alt, 9 covariances), xsens_imu.csv (ns, 4 quaternion, 3 Euler, 3 rates, 3 accelerations, 3
// magnetic).

namespace chainslam::datasets {
namespace {

namespace fs = std::filesystem;

/// x forward, y left, z up of the car to the sensor's, by the release.
SE3d T_base_ouster() {
  constexpr double degree = std::numbers::pi / 180;
  const SO3d R = SO3d::exp(179.6654 * degree * Eigen::Vector3d::UnitZ()) *
                 SO3d::exp(0.0003 * degree * Eigen::Vector3d::UnitY()) *
                 SO3d::exp(0.0001 * degree * Eigen::Vector3d::UnitX());
  return SE3d(R, {1.7042, -0.021, 1.8047});
}

/// The release does not state where the inertial unit sits: LIO-SAM's and FAST-LIO2's settings for MulRan do.
SE3d T_xsens_ouster() { return SE3d(SO3d::from_quaternion(Eigen::Quaterniond(0, 0, 0, 1)), {1.77, 0, -0.05}); }

/// The short form of xsens_imu.csv holds angles only.
bool holds_samples(const fs::path& path) {
  InputFile file(path);
  const auto line = file.read_line();
  return line && std::ranges::count(*line, ',') >= 13;
}

}  // namespace

fs::path mulran_scans(const fs::path& path) {
  for (const char* name : {"Ouster", "sensor_data/Ouster"})
    if (!files_in(path / name, {".bin"}).empty()) return path / name;
  return {};
}

void add_xsens(ScanFiles& parts, const DatasetOptions& options, const fs::path& path) {
  if (!fs::is_regular_file(path)) return;
  if (holds_samples(path))
    add_imu_table(parts, options, path, {.time = 0, .nanoseconds = {}, .gyro = {8, 9, 10}, .accel = {11, 12, 13}});
  else
    parts.info.warnings.push_back(path.filename().string() + " holds angles, no rates and accelerations: not read");
}

std::unique_ptr<Dataset> open_mulran(const fs::path& path, const DatasetOptions& options) {
  const fs::path folder = mulran_scans(path);
  const std::vector<fs::path> files = files_in(folder, {".bin"});
  const std::vector<Timestamp> times = times_of_names(files);
  const auto find = [&](const char* name) {
    for (const fs::path& place : {path, path / "sensor_data", folder.parent_path()})
      if (fs::is_regular_file(place / name)) return place / name;
    return fs::path();
  };
  ScanFiles parts = scans_of(DatasetKind::mulran, path,
                             {"Ouster", SensorKind::lidar, files.size(), "times of points by column, 1024 a turn"},
                             times.front(), times.back());
  DatasetInfo& info = parts.info;
  parts.read = [=](std::size_t i) { return ouster_scan(times[i], read_kitti_bin(files[i])); };
  add_xsens(parts, options, find("xsens_imu.csv"));
  const bool inertial = !parts.others.empty();
  auto extrinsic = find_extrinsic({path, folder.parent_path()});
  if (inertial && !extrinsic) extrinsic = {T_xsens_ouster(), "LIO-SAM's settings for MulRan"};
  set_extrinsic(options, extrinsic, inertial, info);
  if (inertial && !options.T_body_lidar)
    info.notes.emplace_back("T_body_lidar as LIO-SAM's settings for MulRan state it; the release states none");
  if (const fs::path gps = find("gps.csv"); !gps.empty()) {
    info.sensors.push_back(
        {"gps.csv", SensorKind::gnss, std::nullopt, "with the covariance it states, else 3 m and 6 m"});
    const auto rows = std::make_shared<NumberRows>(gps, 12, TimeUnit::nanoseconds, "ns and twelve numbers");
    parts.others.push_back([rows]() -> std::optional<Packet> {
      while (const auto row = rows->next()) {
        const auto& v = row->second;
        const GeodeticPosition position{v[0], v[1], v[2]};
        if (!plausible(position)) continue;
        const double horizontal = 0.5 * (v[3] + v[7]);
        const bool stated = horizontal > 0 && v[11] > 0 && is_finite(horizontal) && is_finite(v[11]);
        return make_fix(row->first, position,
                        stated ? GnssDeviation{std::sqrt(horizontal), std::sqrt(v[11])} : GnssDeviation{3, 6},
                        GnssQuality::three_dimensional);
      }
      return std::nullopt;
    });
    parts.end.push_back([rows] { return rows->cut(); });
  }
  const fs::path poses = find("global_pose.csv");
  info.truth_frame = "MulRan, UTM";
  set_truth(parts, options, poses, [poses, T_base_body = T_base_ouster() * info.T_body_lidar.inverse()] {
    Trajectory truth = read_pose_table(
        poses, ',', [](LineFields& fields) { return time_field(fields, TimeUnit::nanoseconds); },
        detail::read_matrix_3x4);
    for (SE3d& pose : truth.poses) pose = pose * T_base_body;
    return truth;
  });
  return dataset_of(std::move(parts));
}

}  // namespace chainslam::datasets
