#include "datasets/cloud_folder.hpp"

#include <algorithm>
#include <string>
#include <utility>

#include "chainslam/core/error.hpp"
#include "chainslam/io/input_file.hpp"
#include "chainslam/io/pcd.hpp"
#include "chainslam/io/ply.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "datasets/dataset.hpp"
#include "datasets/extrinsic.hpp"
#include "datasets/files.hpp"
#include "datasets/imu_table.hpp"
#include "datasets/scan_files.hpp"
#include "datasets/statistics.hpp"

// A folder of clouds: .pcd, .ply or KITTI's .bin (all of one kind), in the order of the numbers in their names. Times
// come from times.txt or timestamps.txt beside them, else from the names, else from a given rate. Truth:
// poses/<name>.txt or poses.txt (3x4 rows), or a trajectory as TUM's, groundtruth.txt or the only .tum file. An
// IMU's table beside them is read, too (see `find_imu_table`), where the LiDAR sits on it (see `find_extrinsic`), and
// the first line of simulation/source.txt, which says what of the data is simulated.

namespace chainslam::datasets {
namespace {

const std::vector<std::string_view> cloud_extensions{".pcd", ".ply", ".bin"};

std::string extension_of(const std::filesystem::path& file) {
  std::string extension = file.extension().string();
  std::ranges::transform(extension, extension.begin(),
                         [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + 32) : c; });
  return extension;
}

PointFile read_cloud(const std::filesystem::path& file) {
  const std::string extension = extension_of(file);
  if (extension == ".pcd") return read_pcd_file(file);
  if (extension == ".ply") return read_ply_file(file);
  PointFile points;
  points.cloud = read_kitti_bin(file);
  return points;
}

/// Where the times of a folder's clouds come from.
struct CloudTimes {
  std::vector<Timestamp> times;
  std::string source;
};

CloudTimes find_times(const std::filesystem::path& path, const std::filesystem::path& folder,
                      const std::vector<std::filesystem::path>& files, double rate) {
  for (const auto& place : {folder, path, folder.parent_path()})
    for (const char* name : {"times.txt", "timestamps.txt"})
      if (std::filesystem::is_regular_file(place / name)) return {read_stamps(place / name), (place / name).string()};
  CloudTimes named{{}, "the files' names"};
  for (const auto& file : files)
    if (const auto time = time_of_name(file.stem().string())) named.times.push_back(*time);
  if (named.times.size() == files.size()) {
    if (!std::ranges::is_sorted(named.times))
      throw_input_error(folder.string(), "", "names whose times are not in order",
                        "name the files so that they sort by time");
    return named;
  }
  if (!(rate > 0))
    throw_input_error(folder.string(), "", "no times of the clouds",
                      "add times.txt with one time in seconds a line, or give a rate");
  CloudTimes made{{}, ""};
  for (std::size_t i = 0; i < files.size(); ++i)
    made.times.push_back(Timestamp(seconds(static_cast<double>(i) / rate)));
  return made;
}

/// Poses of the clouds one by one: poses/<name>.txt for each, poses.txt, or a trajectory as TUM's.
struct CloudTruth {
  std::filesystem::path path;  ///< a file, or the folder of `of_clouds`; empty if there is none
  std::vector<std::filesystem::path> of_clouds{};
};

CloudTruth find_truth(const std::filesystem::path& path, const std::filesystem::path& folder,
                      const std::vector<std::filesystem::path>& files) {
  for (const auto& place : {path, folder.parent_path()}) {
    std::vector<std::filesystem::path> poses;
    for (const auto& file : files)
      if (auto pose = place / "poses" / (file.stem().string() + ".txt"); std::filesystem::is_regular_file(pose))
        poses.push_back(std::move(pose));
    if (poses.size() == files.size()) return {place / "poses", std::move(poses)};
    for (const char* name : {"poses.txt", "groundtruth.txt"})
      if (std::filesystem::is_regular_file(place / name)) return {place / name};
    if (const auto trajectories = files_in(place, {".tum"}); trajectories.size() == 1) return {trajectories.front()};
  }
  return {};
}

Trajectory read_truth(const CloudTruth& truth, const std::vector<Timestamp>& times, std::size_t clouds) {
  if (truth.path.extension() == ".tum" || truth.path.filename() == "groundtruth.txt") return read_tum(truth.path);
  Trajectory trajectory;
  for (const auto& file : truth.of_clouds) {
    const Trajectory one = read_kitti_poses(file);
    if (one.empty()) throw_input_error(file.string(), "", "no pose", "write a row-major 3x4 matrix into it");
    trajectory.poses.push_back(one.poses.front());
  }
  if (truth.of_clouds.empty()) trajectory = read_kitti_poses(truth.path);
  const std::size_t count = std::min(trajectory.poses.size(), clouds);
  trajectory.poses.resize(count);
  trajectory.times.assign(times.begin(), times.begin() + static_cast<std::ptrdiff_t>(count));
  return trajectory;
}

/// What the clouds' time field means, by the first cloud; says so.
std::optional<PointTimeRule> infer_times(const PointFile& first, Timestamp time, const PointTimeHints& hints,
                                         DatasetInfo& info) {
  info.motion_corrected = first.time_field.empty();
  if (first.time_field.empty()) {
    info.notes.emplace_back("no time per point: clouds are taken as snapshots");
    return std::nullopt;
  }
  const PointTimeInference inference = infer_point_time(first.times, time, hints);
  const std::string sentence = "field " + first.time_field + ": " + inference.sentence;
  if (inference.status == PointTimeStatus::inferred) {
    info.notes.push_back(sentence);
    return inference.rule;
  }
  info.motion_corrected = true;
  const bool absent = inference.status == PointTimeStatus::absent;
  (absent ? info.notes : info.warnings)
      .push_back(sentence + "; clouds are taken as snapshots" + (absent ? "" : point_time_settings));
  return std::nullopt;
}

LidarScan read_scan(const std::filesystem::path& file, Timestamp time, const std::optional<PointTimeRule>& rule) {
  PointFile points = read_cloud(file);
  LidarScan scan{.time = time, .end = time, .cloud = std::move(points.cloud)};
  if (!rule || points.times.size() != scan.cloud.size() || scan.cloud.empty()) return scan;
  set_point_times(scan, *rule, points.times, time, file);
  return scan;
}

}  // namespace

std::filesystem::path folder_of_clouds(const std::filesystem::path& path) {
  if (!files_in(path, cloud_extensions).empty()) return path;
  for (const char* name : {"clouds", "Scans", "velodyne", "velodyne_points/data", "lidar", "scans", "pcd", "ply"})
    if (!files_in(path / name, cloud_extensions).empty()) return path / name;
  return {};
}

std::unique_ptr<Dataset> open_clouds(const std::filesystem::path& path, const DatasetOptions& options) {
  const std::filesystem::path folder = folder_of_clouds(path);
  std::vector<std::filesystem::path> files = files_in(folder, cloud_extensions);
  if (files.empty())
    throw_input_error(path.string(), "", contents_of(path), "a folder of .pcd, .ply or .bin clouds is needed");
  const std::string first = extension_of(files.front());
  std::erase_if(files, [&](const auto& file) { return extension_of(file) != first; });
  const CloudTimes found = find_times(path, folder, files, options.scan_rate);
  const std::vector<Timestamp>& times = found.times;
  if (times.size() < files.size())
    throw_input_error(found.source, "",
                      std::to_string(times.size()) + " times for " + std::to_string(files.size()) + " clouds",
                      "give one line for each cloud");
  ScanFiles parts = scans_of(DatasetKind::clouds, path,
                             {folder.filename().string(), SensorKind::lidar, files.size(), first.substr(1) + " files"},
                             times.front(), times[files.size() - 1]);
  DatasetInfo& info = parts.info;
  if (found.source.empty())
    info.warnings.push_back("nothing states when the clouds were taken: " + text_of(options.scan_rate) +
                            " Hz assumed; add times.txt or set the rate");
  else
    info.notes.push_back("times from " + found.source);
  if (times.size() > files.size())
    info.warnings.push_back(std::to_string(times.size() - files.size()) + " times have no cloud");
  parts.read = [files, times, rule = infer_times(read_cloud(files.front()), times.front(), options.point_time, info)](
                   std::size_t i) { return read_scan(files[i], times[i], rule); };
  for (const auto& place : {path, folder.parent_path()})
    if (const auto table = find_imu_table(place); !table.empty() && parts.others.empty()) {
      add_imu_table(parts, options, table, imu_columns(table));
    }
  set_extrinsic(options, find_extrinsic({path, folder, folder.parent_path()}), !parts.others.empty(), info);
  if (const auto source = path / "simulation/source.txt"; std::filesystem::is_regular_file(source)) {
    InputFile file(source);
    info.source = file.read_line().value_or("simulated");
    info.notes.push_back(info.source);
  }
  CloudTruth truth = options.truth.empty() ? find_truth(path, folder, files) : CloudTruth{options.truth};
  info.truth = truth.path;
  if (!truth.path.empty())
    parts.truth = [truth, times, count = files.size()] { return read_truth(truth, times, count); };
  return dataset_of(std::move(parts));
}

}  // namespace chainslam::datasets
