#include <algorithm>
#include <array>
#include <string>

#include "chainslam/core/error.hpp"
#include "chainslam/io/tum.hpp"
#include "datasets/cloud_folder.hpp"
#include "datasets/dataset.hpp"
#include "datasets/files.hpp"
#include "datasets/nuscenes.hpp"
#include "datasets/ros_recording.hpp"

namespace chainslam::datasets {
namespace {

constexpr const char* known_trees =
    "give one of these kinds:\n"
    "    nclt          velodyne_hits.bin or velodyne_sync/<utime>.bin [ms25.csv gps.csv gps_rtk.csv groundtruth*.csv]\n"
    "    range_images  data/*.png velodyne_config.txt timestamps_start.txt timestamps_end.txt, or *.png img.cfg "
    "imu.cfg\n"
    "    keyframes     Scans/*.pcd times.txt odom_poses.txt\n"
    "    ros           a .bag, .mcap or .db3, or a folder of its parts\n"
    "    nuscenes      v1.0*/*.json sweeps/ [samples/], as nuScenes and MARS have them; DIR/SCENE names a scene\n"
    "    clouds        *.pcd, *.ply or *.bin, also in velodyne/ or clouds/ [times.txt]";

bool is_file(const std::filesystem::path& path) { return std::filesystem::is_regular_file(path); }

bool holds_nclt(const std::filesystem::path& path) {
  return is_file(path / "velodyne_hits.bin") || std::filesystem::is_directory(path / "velodyne_sync") ||
         std::filesystem::is_directory(path / "velodyne_data");
}

/// The folders in a folder that are data sets of a known kind, as unpacked archives hold them.
std::vector<std::filesystem::path> inner_folders(const std::filesystem::path& path) {
  std::vector<std::filesystem::path> found;
  std::error_code missing;
  for (const auto& entry : std::filesystem::directory_iterator(path, missing))
    if (entry.is_directory() && recognise(entry.path())) found.push_back(entry.path());
  std::ranges::sort(found);
  return found;
}

/// The folder itself, or the only data set in it.
std::filesystem::path folder_of_dataset(const std::filesystem::path& path) {
  if (recognise(path)) return path;
  const std::vector<std::filesystem::path> inner = inner_folders(path);
  if (inner.size() == 1) return inner.front();
  if (inner.empty()) throw_input_error(path.string(), "", contents_of(path), known_trees);
  std::string names;
  for (const auto& folder : inner) names += (names.empty() ? "" : ", ") + folder.filename().string();
  throw_input_error(path.string(), "", std::to_string(inner.size()) + " data sets", "name one of them: " + names);
}

}  // namespace

std::string_view name_of(DatasetKind kind) {
  constexpr std::array<std::string_view, 6> names{"nclt", "range_images", "keyframes", "ros", "nuscenes", "clouds"};
  return names[static_cast<std::size_t>(kind)];
}

std::optional<Trajectory> Dataset::truth() const {
  if (info_.truth.empty()) return std::nullopt;
  return read_tum(info_.truth);
}

std::optional<DatasetKind> recognise(const std::filesystem::path& path) {
  if (holds_nclt(path)) return DatasetKind::nclt;
  if (is_file(path / "velodyne_config.txt") || is_file(path / "img.cfg")) return DatasetKind::range_images;
  if (!files_in(path / "Scans", {".pcd"}).empty() && is_file(path / "times.txt") &&
      (is_file(path / "odom_poses.txt") || is_file(path / "optimized_poses.txt")))
    return DatasetKind::keyframes;
  if (!nuscenes_tables(path).empty()) return DatasetKind::nuscenes;
  if (!recording_files(path).empty()) return DatasetKind::ros;
  if (!folder_of_clouds(path).empty()) return DatasetKind::clouds;
  return std::nullopt;
}

std::unique_ptr<Dataset> open_dataset(const std::filesystem::path& path, const DatasetOptions& options) {
  if (!std::filesystem::exists(path) && !recognise(path))
    throw_input_error(path.string(), "", "no such file or folder", "check the path");
  if (!std::filesystem::is_directory(path) && !recognise(path))
    throw_input_error(path.string(), "", "a file of no known kind of recording",
                      "name the folder that holds the data set, or a recording (.bag, .mcap, .db3)");
  const std::filesystem::path folder = options.kind ? path : folder_of_dataset(path);
  const DatasetKind kind = options.kind ? *options.kind : *recognise(folder);
  switch (kind) {
    case DatasetKind::nclt:
      return open_nclt(folder, options);
    case DatasetKind::range_images:
      return open_range_images(folder, options);
    case DatasetKind::keyframes:
      return open_keyframes(folder, options);
    case DatasetKind::ros:
      return open_ros(folder, options);
    case DatasetKind::nuscenes:
      return open_nuscenes(folder, options);
    case DatasetKind::clouds:
      break;
  }
  return open_clouds(folder, options);
}

}  // namespace chainslam::datasets
