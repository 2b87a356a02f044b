#include <algorithm>
#include <array>
#include <string>

#include "chainslam/core/error.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "datasets/cloud_folder.hpp"
#include "datasets/dataset.hpp"
#include "datasets/files.hpp"
#include "datasets/helipr.hpp"
#include "datasets/mulran.hpp"
#include "datasets/newer_college.hpp"
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
    "    kitti         velodyne/*.bin times.txt calib.txt [poses.txt or ../../poses/NN.txt]\n"
    "    kitti_raw     velodyne_points/data velodyne_points/timestamps*.txt [oxts/ ../calib_imu_to_velo.txt]\n"
    "    mulran        Ouster/<ns>.bin or sensor_data/Ouster/<ns>.bin [xsens_imu.csv gps.csv global_pose.csv]\n"
    "    helipr        LiDAR/<sensor>/<ns>.bin [Inertial_data/ LiDAR_GT/]\n"
    "    newer_college raw_format/ouster_scan/cloud_<sec>_<nsec>.pcd [ground_truth/registered_poses.csv imu.csv]\n"
    "    ros           a .bag, .mcap or .db3, or a folder of its parts\n"
    "    nuscenes      v1.0*/*.json sweeps/ [samples/], as nuScenes and MARS have them; DIR/SCENE names a scene\n"
    "    clouds        *.pcd, *.ply or *.bin, also in velodyne/ or clouds/ [times.txt imu.csv poses.txt or a .tum]";

bool is_file(const std::filesystem::path& path) { return std::filesystem::is_regular_file(path); }

bool holds_nclt(const std::filesystem::path& path) {
  return is_file(path / "velodyne_hits.bin") || std::filesystem::is_directory(path / "velodyne_sync") ||
         std::filesystem::is_directory(path / "velodyne_data");
}

/// A kind of data set: how it is known by the names at a path, and opened.
struct Kind {
  std::string_view name;
  bool (*is_at)(const std::filesystem::path& path);
  std::unique_ptr<Dataset> (*open)(const std::filesystem::path& path, const DatasetOptions& options);
};

using Path = std::filesystem::path;

/// In the order of `DatasetKind`, which is also that in which they are tried: what is particular comes first.
constexpr std::array<Kind, 11> kinds{{
    {"nclt", holds_nclt, open_nclt},
    {"range_images", [](const Path& p) { return is_file(p / "velodyne_config.txt") || is_file(p / "img.cfg"); },
     open_range_images},
    {"keyframes",
     [](const Path& p) {
       return is_file(p / "times.txt") && (is_file(p / "odom_poses.txt") || is_file(p / "optimized_poses.txt")) &&
              !files_in(p / "Scans", {".pcd"}).empty();
     },
     open_keyframes},
    {"kitti",
     [](const Path& p) {
       return is_file(p / "calib.txt") && is_file(p / "times.txt") && !files_in(p / "velodyne", {".bin"}).empty();
     },
     open_kitti},
    {"kitti_raw",
     [](const Path& p) {
       const Path scans = p / "velodyne_points";
       return is_file(scans / "timestamps.txt") || is_file(scans / "timestamps_start.txt");
     },
     open_kitti_raw},
    {"mulran", [](const Path& p) { return !mulran_scans(p).empty(); }, open_mulran},
    {"helipr", [](const Path& p) { return !helipr_scans(p).empty(); }, open_helipr},
    {"newer_college", [](const Path& p) { return !newer_college_scans(p).empty(); }, open_newer_college},
    {"nuscenes", [](const Path& p) { return !nuscenes_tables(p).empty(); }, open_nuscenes},
    {"ros", [](const Path& p) { return !recording_files(p).empty(); }, open_ros},
    {"clouds", [](const Path& p) { return !folder_of_clouds(p).empty(); }, open_clouds},
}};

/// The folders in a folder that are data sets of a known kind, as unpacked archives hold them.
std::vector<std::filesystem::path> inner_folders(const std::filesystem::path& path) {
  std::vector<std::filesystem::path> found;
  std::error_code missing;
  for (const auto& entry : std::filesystem::directory_iterator(path, missing))
    if (entry.is_directory() && recognize(entry.path())) found.push_back(entry.path());
  std::ranges::sort(found);
  return found;
}

/// The folder itself, or the only data set in it.
std::filesystem::path folder_of_dataset(const std::filesystem::path& path) {
  if (recognize(path)) return path;
  const std::vector<std::filesystem::path> inner = inner_folders(path);
  if (inner.size() == 1) return inner.front();
  if (inner.empty()) throw_input_error(path.string(), "", contents_of(path), known_trees);
  std::string names;
  for (const auto& folder : inner) names += (names.empty() ? "" : ", ") + folder.filename().string();
  throw_input_error(path.string(), "", std::to_string(inner.size()) + " data sets", "name one of them: " + names);
}

}  // namespace

std::string_view name_of(DatasetKind kind) { return kinds[static_cast<std::size_t>(kind)].name; }

std::optional<Trajectory> Dataset::truth() const {
  if (info_.truth.empty()) return std::nullopt;
  return read_tum(info_.truth);
}

std::optional<DatasetKind> recognize(const std::filesystem::path& path) {
  const auto found = std::ranges::find_if(kinds, [&](const Kind& kind) { return kind.is_at(path); });
  return found == kinds.end() ? std::nullopt : std::optional(static_cast<DatasetKind>(found - kinds.begin()));
}

std::unique_ptr<Dataset> open_dataset(const std::filesystem::path& path, const DatasetOptions& options) {
  if (!std::filesystem::exists(path) && !recognize(path))
    throw_input_error(path.string(), "", "no such file or folder", "check the path");
  if (!std::filesystem::is_directory(path) && !recognize(path))
    throw_input_error(path.string(), "", "a file of no known kind of recording",
                      "name the folder that holds the data set, or a recording (.bag, .mcap, .db3)");
  const std::filesystem::path folder = options.kind ? path : folder_of_dataset(path);
  const DatasetKind kind = options.kind ? *options.kind : *recognize(folder);
  return kinds[static_cast<std::size_t>(kind)].open(folder, options);
}

}  // namespace chainslam::datasets
