#include <algorithm>
#include <optional>
#include <string>
#include <utility>

#include "chainslam/core/types.hpp"
#include "chainslam/io/input_file.hpp"
#include "chainslam/io/pcd.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "datasets/dataset.hpp"
#include "datasets/files.hpp"
#include "datasets/geodesy.hpp"
#include "datasets/odometry_recording.hpp"
#include "datasets/scan_files.hpp"

// Keyframes with recorded odometry, as SC-A-LOAM and FAST-LIO-SAM save them:
//   Scans/%06d.pcd, times.txt (seconds), odom_poses.txt or, if there is none, optimized_poses.txt (rows of 3x4).
//   gnss.txt, if there is one: latitude and longitude in degrees, height above the ellipsoid in metres, and one
//   standard deviation along the ground in metres; nan nan nan nan where there was no fix.
// Line i belongs to scan i; more lines than scans are allowed. Clouds are in the body frame.

namespace chainslam::datasets {
namespace {

/// The fixes of gnss.txt, nothing where the line says nan. @throws IoError naming the line.
std::vector<std::optional<GnssFix>> read_fixes(const std::filesystem::path& path, const std::vector<Timestamp>& times) {
  std::vector<std::optional<GnssFix>> fixes;
  InputFile file(path);
  while (const auto line = file.read_line()) {
    if (detail::trimmed(*line).empty() || fixes.size() == times.size()) continue;
    LineFields fields(file, *line);
    const GeodeticPosition position{.latitude_deg = fields.number_or_nan("latitude"),
                                    .longitude_deg = fields.number_or_nan("longitude"),
                                    .altitude = fields.number_or_nan("height")};
    const double sigma = fields.number_or_nan("deviation");
    fields.end("four fields: latitude longitude height deviation");
    const bool usable = plausible(position) && sigma > 0 && is_finite(sigma);
    fixes.push_back(usable ? std::optional(make_fix(times[fixes.size()], position, {sigma, 2 * sigma},
                                                    GnssQuality::three_dimensional))
                           : std::nullopt);
  }
  fixes.resize(times.size());
  return fixes;
}

class KeyframeSet final : public Dataset {
 public:
  KeyframeSet(const std::filesystem::path& path, const DatasetOptions& options)
      : scans_(files_in(path / "Scans", {".pcd"})), times_(read_stamps(path / "times.txt")) {
    const bool odometry = std::filesystem::exists(path / "odom_poses.txt");
    const std::filesystem::path poses = path / (odometry ? "odom_poses.txt" : "optimized_poses.txt");
    poses_ = read_kitti_poses(poses).poses;
    const std::size_t lines = std::min(times_.size(), poses_.size());
    if (scans_.empty() || lines < scans_.size())
      throw_input_error(path.string(), "",
                        std::to_string(scans_.size()) + " scans, " + std::to_string(times_.size()) + " times, " +
                            std::to_string(poses_.size()) + " poses",
                        "give at least one line of times.txt and of " + poses.filename().string() + " for each scan");
    info_.kind = DatasetKind::keyframes;
    info_.path = path;
    info_.name = folder_name(path);
    info_.truth = options.truth;
    info_.T_body_lidar = options.T_body_lidar.value_or(SE3d());
    info_.motion_corrected = info_.has_odometry = true;
    info_.start = times_.front();
    info_.end = times_[scans_.size() - 1];
    info_.sensors.push_back({"Scans", SensorKind::lidar, scans_.size(), "keyframes, corrected for motion"});
    if (std::filesystem::exists(path / "gnss.txt")) {
      fixes_ = read_fixes(path / "gnss.txt", times_);
      const auto usable = std::ranges::count_if(fixes_, [](const auto& fix) { return fix.has_value(); });
      info_.sensors.push_back({"gnss.txt", SensorKind::gnss, static_cast<std::size_t>(usable), "a fix a keyframe"});
    }
    if (!odometry) info_.notes.emplace_back("no odom_poses.txt: optimized_poses.txt is taken for the odometry");
    if (lines > scans_.size())
      info_.notes.push_back(std::to_string(lines - scans_.size()) + " poses have no scan and are not used");
  }

  std::optional<Packet> next() override {
    auto cloud = next_cloud();
    if (!cloud) return std::nullopt;
    const Timestamp time = times_[scan_ - 1];
    return LidarScan{.time = time, .end = time, .cloud = std::move(*cloud)};
  }

  std::optional<Frame> next_frame() override {
    auto cloud = next_cloud();
    if (!cloud) return std::nullopt;
    const std::size_t i = scan_ - 1;
    Frame frame;
    frame.time = times_[i];
    frame.T_odom_body = poses_[i];
    frame.covariance.setZero();  // unknown
    frame.cloud = std::move(*cloud);
    if (!fixes_.empty()) frame.gnss = fixes_[i];
    frame.health.points = frame.health.matches = to_index(frame.cloud.size());
    return frame;
  }

 private:
  /// The next cloud that can be read, number `scan_` - 1; nothing at the end.
  std::optional<PointCloud<float>> next_cloud() {
    while (scan_ < scans_.size()) try {
        PointCloud<float> cloud = read_pcd(scans_[scan_++]);
        cloud.time_offsets.clear();
        return cloud;
      } catch (const IoError& error) {
        lost_.add(error);
      }
    if (std::string loss = lost_.sentence(); !std::exchange(noted_, true) && !loss.empty())
      info_.warnings.push_back(std::move(loss));
    return std::nullopt;
  }

  std::vector<std::filesystem::path> scans_;
  std::vector<Timestamp> times_;
  std::vector<SE3d> poses_;
  std::vector<std::optional<GnssFix>> fixes_;
  std::size_t scan_ = 0;  ///< that is read next
  LeftOut lost_;
  bool noted_ = false;
};

}  // namespace

std::unique_ptr<Dataset> open_keyframes(const std::filesystem::path& path, const DatasetOptions& options) {
  if (is_recorded_odometry(path)) return open_recorded_odometry(path, options);
  return std::make_unique<KeyframeSet>(path, options);
}

}  // namespace chainslam::datasets
