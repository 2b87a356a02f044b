#include "datasets/cloud_folder.hpp"

#include <algorithm>
#include <string>
#include <utility>

#include "chainslam/io/kitti.hpp"
#include "chainslam/io/pcd.hpp"
#include "chainslam/io/ply.hpp"
#include "chainslam/io/tum.hpp"
#include "datasets/dataset.hpp"
#include "datasets/files.hpp"
#include "datasets/statistics.hpp"

// A folder of clouds: .pcd, .ply or KITTI's .bin (all of one kind), in the order of the numbers in their names. Times
// come from times.txt or timestamps.txt beside them, else from the names, else from a given rate. Truth:
// poses/<name>.txt or poses.txt (3x4 rows), or a .tum file. KITTI's sequences, nuScenes' converted scenes and Newer
// College's clouds are such.

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

class CloudFolder final : public Dataset {
 public:
  CloudFolder(const std::filesystem::path& path, const DatasetOptions& options)
      : folder_(folder_of_clouds(path)), files_(files_in(folder_, cloud_extensions)), hints_(options.point_time) {
    if (files_.empty())
      throw_input_error(path.string(), "", contents_of(path), "a folder of .pcd, .ply or .bin clouds is needed");
    const std::string first = extension_of(files_.front());
    std::erase_if(files_, [&](const auto& file) { return extension_of(file) != first; });
    CloudTimes times = find_times(path, folder_, files_, options.scan_rate);
    times_ = std::move(times.times);
    if (times_.size() < files_.size())
      throw_input_error(times.source, "",
                        std::to_string(times_.size()) + " times for " + std::to_string(files_.size()) + " clouds",
                        "give one line for each cloud");
    info_.kind = DatasetKind::clouds;
    info_.path = path;
    info_.name = folder_name(path);
    info_.T_body_lidar = options.T_body_lidar.value_or(SE3d());
    info_.start = times_.front();
    info_.end = times_[files_.size() - 1];
    info_.sensors.push_back(
        {folder_.filename().string(), SensorKind::lidar, files_.size(), first.substr(1) + " files"});
    if (times.source.empty())
      info_.oddities.push_back("nothing states when the clouds were taken: " + text_of(options.scan_rate) +
                               " Hz assumed; add times.txt or set the rate");
    else
      info_.notes.push_back("times from " + times.source);
    if (times_.size() > files_.size())
      info_.oddities.push_back(std::to_string(times_.size() - files_.size()) + " times have no cloud");
    find_truth(options);
    infer_times(read_cloud(files_.front()));
  }

  std::optional<Packet> next() override {
    if (cloud_ == files_.size()) return std::nullopt;
    const std::size_t i = cloud_++;
    PointFile points = read_cloud(files_[i]);
    LidarScan scan{.time = times_[i], .end = times_[i], .cloud = std::move(points.cloud)};
    if (rule_ && points.times.size() == scan.cloud.size() && !scan.cloud.empty()) {
      PointTimes point_times = apply_point_time(*rule_, points.times, times_[i]);
      scan.time = point_times.time;
      scan.end = point_times.end;
      scan.cloud.time_offsets = std::move(point_times.offsets);
    }
    return scan;
  }

  std::optional<Trajectory> truth() const override {
    if (pose_files_.empty() && info_.truth.extension() == ".tum") return read_tum(info_.truth);
    Trajectory trajectory;
    if (!pose_files_.empty()) {
      for (const auto& file : pose_files_) trajectory.poses.push_back(read_kitti_poses(file).poses.at(0));
    } else if (!info_.truth.empty()) {
      trajectory = read_kitti_poses(info_.truth);
    } else {
      return std::nullopt;
    }
    const std::size_t count = std::min(trajectory.poses.size(), files_.size());
    trajectory.poses.resize(count);
    trajectory.times.assign(times_.begin(), times_.begin() + static_cast<std::ptrdiff_t>(count));
    return trajectory;
  }

 private:
  void infer_times(const PointFile& first) {
    info_.motion_corrected = first.time_field.empty();
    if (first.time_field.empty()) {
      info_.notes.emplace_back("no time per point: clouds are taken as snapshots");
      return;
    }
    const PointTimeInference inference = infer_point_time(first.times, times_.front(), hints_);
    const std::string sentence = "field " + first.time_field + ": " + inference.sentence;
    if (inference.status == PointTimeStatus::inferred) {
      rule_ = inference.rule;
      info_.notes.push_back(sentence);
      return;
    }
    info_.motion_corrected = true;
    (inference.status == PointTimeStatus::absent ? info_.notes : info_.oddities)
        .push_back(sentence + "; clouds are taken as snapshots");
  }

  void find_truth(const DatasetOptions& options) {
    info_.truth = options.truth;
    if (!info_.truth.empty()) return;
    for (const auto& place : {info_.path, folder_.parent_path()}) {
      std::vector<std::filesystem::path> poses;
      for (const auto& file : files_)
        if (const auto pose = place / "poses" / (file.stem().string() + ".txt"); std::filesystem::is_regular_file(pose))
          poses.push_back(pose);
      if (poses.size() == files_.size()) {
        pose_files_ = std::move(poses);
        info_.truth = place / "poses";
        return;
      }
      if (std::filesystem::is_regular_file(place / "poses.txt")) {
        info_.truth = place / "poses.txt";
        return;
      }
    }
  }

  std::filesystem::path folder_;
  std::vector<std::filesystem::path> files_;
  std::vector<Timestamp> times_;
  std::vector<std::filesystem::path> pose_files_;
  PointTimeHints hints_;
  std::optional<PointTimeRule> rule_;
  std::size_t cloud_ = 0;
};

}  // namespace

std::filesystem::path folder_of_clouds(const std::filesystem::path& path) {
  if (!files_in(path, cloud_extensions).empty()) return path;
  for (const char* name : {"clouds", "Scans", "velodyne", "velodyne_points/data", "lidar", "scans", "pcd", "ply"})
    if (!files_in(path / name, cloud_extensions).empty()) return path / name;
  return {};
}

std::unique_ptr<Dataset> open_clouds(const std::filesystem::path& path, const DatasetOptions& options) {
  return std::make_unique<CloudFolder>(path, options);
}

}  // namespace chainslam::datasets
