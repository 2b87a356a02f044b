#include "datasets/inspect.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <set>
#include <string>
#include <utility>

#include "chainslam/io/g2o.hpp"
#include "chainslam/io/pcd.hpp"
#include "chainslam/io/ply.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/sensor/imu_check.hpp"
#include "chainslam/sensor/imu_units.hpp"
#include "datasets/files.hpp"
#include "datasets/ground_check.hpp"
#include "datasets/imu_findings.hpp"
#include "datasets/nclt.hpp"
#include "datasets/statistics.hpp"

namespace chainslam::datasets {
namespace {

std::string text_of_vector(const Eigen::Vector3d& v, int decimals = 3) {
  return text_of(v.x(), decimals) + " " + text_of(v.y(), decimals) + " " + text_of(v.z(), decimals);
}

std::string text_of_pose(const SE3d& pose) {
  const Eigen::Vector3d rotation = pose.rotation().log();
  return text_of_vector(pose.translation()) + " m, turned by " + text_of(rotation.norm() * 180 / std::numbers::pi, 2) +
         " deg";
}

std::string text_of_ground(const GroundCheck& ground) {
  if (ground.side == GroundSide::unclear) return "no clear level plane";
  return "densest level plane " + text_of(std::abs(ground.height), 2) + " m " +
         (ground.side == GroundSide::below ? "below" : "above") + " the sensor, " + text_of(100 * ground.share, 0) +
         " % of the points 3 to 30 m away";
}

void add_trajectory(const std::string& name, const Trajectory& trajectory, Inspection& result) {
  TimeStatistics times;
  for (const Timestamp time : trajectory.times) times.add(time);
  if (trajectory.has_times())
    times.report(name, result.facts, result.warnings);
  else
    result.facts.emplace_back(name, std::to_string(trajectory.size()) + " poses without times");
  if (trajectory.empty()) {
    result.warnings.push_back(name + ": no poses");
    return;
  }
  double longest = 0;
  Eigen::Vector3d low = trajectory.poses[0].translation(), high = low;
  for (std::size_t i = 1; i < trajectory.size(); ++i) {
    const Eigen::Vector3d here = trajectory.poses[i].translation();
    longest = std::max(longest, (here - trajectory.poses[i - 1].translation()).norm());
    low = low.cwiseMin(here);
    high = high.cwiseMax(here);
  }
  result.facts.emplace_back(name + " path",
                            text_of(path_length(trajectory), 2) + " m, longest step " + text_of(longest, 2) + " m");
  result.facts.emplace_back(name + " extent", text_of_vector(low, 2) + " to " + text_of_vector(high, 2) + " m");
}

Inspection inspect_cloud(const std::string& kind, const PointFile& file) {
  Inspection result{.kind = kind, .facts = {}, .warnings = {}};
  CloudStatistics points;
  points.add(file.cloud);
  points.report(result.facts, result.warnings);
  result.facts.emplace_back("ground", text_of_ground(find_ground(file.cloud)) + ", if z is up");
  if (!file.time_field.empty())
    result.facts.emplace_back("field " + file.time_field, infer_point_time(file.times, std::nullopt).sentence);
  return result;
}

template <class Pose>
void add_graph(const std::string& name, const G2oRecords<Pose>& records, Inspection& result) {
  if (records.vertices.empty() && records.edges.empty()) return;
  std::set<std::int64_t> given, named;
  for (const auto& vertex : records.vertices) given.insert(vertex.id);
  std::size_t closures = 0;
  for (const auto& edge : records.edges) {
    named.insert({edge.from, edge.to});
    closures += std::abs(edge.to - edge.from) != 1 ? 1 : 0;
  }
  const auto missing = std::ranges::count_if(named, [&](std::int64_t id) { return !given.contains(id); });
  const auto loose = std::ranges::count_if(given, [&](std::int64_t id) { return !named.contains(id); });
  result.facts.emplace_back(name, std::to_string(records.vertices.size()) + " vertices, " +
                                      std::to_string(records.edges.size()) + " edges, " + std::to_string(closures) +
                                      " of them not from one id to the next");
  if (missing > 0)
    result.warnings.push_back(name + ": " + std::to_string(missing) + " vertices are named by edges but not given");
  if (loose > 0) result.warnings.push_back(name + ": " + std::to_string(loose) + " vertices have no edge");
}

Inspection inspect_graph(const std::filesystem::path& path) {
  const G2oFile graph = read_g2o(path);
  Inspection result{.kind = "g2o pose graph", .facts = {}, .warnings = {}};
  add_graph("SE(2)", graph.planar, result);
  add_graph("SE(3)", graph.spatial, result);
  if (result.facts.empty()) result.warnings.emplace_back("neither vertices nor edges");
  result.facts.emplace_back("fixed", std::to_string(graph.fixed.size()) + " vertices");
  for (const auto& [tag, count] : graph.unknown)
    result.warnings.push_back(std::to_string(count) + " lines of the unknown kind " + tag);
  return result;
}

/// Number of fields in the first line that is no comment, or 0.
std::size_t fields_in(const std::filesystem::path& path, char separator = ' ') {
  InputFile file(path);
  while (const auto line = file.read_line()) {
    LineFields fields(file, *line, separator);
    if (!fields.more() || detail::trimmed(*line).starts_with('#')) continue;
    std::size_t count = 0;
    for (; fields.more() && count < 20; ++count) static_cast<void>(fields.text("field"));
    return count;
  }
  return 0;
}

Inspection inspect_file(const std::filesystem::path& path) {
  const std::string extension = path.extension().string();
  if (extension == ".pcd") return inspect_cloud("PCD cloud", read_pcd_file(path));
  if (extension == ".ply") return inspect_cloud("PLY cloud", read_ply_file(path));
  if (extension == ".g2o") return inspect_graph(path);
  if (extension == ".bin")
    return inspect_cloud("KITTI scan", {.cloud = read_kitti_bin(path), .time_field = "", .times = {}});
  Inspection result;
  const auto take = [&](const char* kind, const Trajectory& trajectory) {
    result.kind = kind;
    add_trajectory("poses", trajectory, result);
    return result;
  };
  if (extension == ".csv" && fields_in(path, ',') == 7) return take("NCLT ground truth", read_nclt_ground_truth(path));
  if (extension == ".csv") return take("EuRoC trajectory", read_euroc_csv(path));
  const std::size_t fields = fields_in(path);
  if (extension == ".tum" || fields == 8) return take("TUM trajectory", read_tum(path));
  if (fields == 12) return take("KITTI trajectory", read_kitti_poses(path));
  throw_input_error(path.string(), "", "a file of no known kind",
                    "inspect reads .pcd, .ply, .bin, .tum, .csv, .g2o, rows of 8 or 12 numbers, and folders");
}

/// Gathers what a data set's packets say of themselves.
class PacketStatistics {
 public:
  void add(const Packet& packet) {
    times_[static_cast<std::size_t>(sensor_kind(packet))].add(available_at(packet));
    if (const auto* scan = std::get_if<LidarScan>(&packet)) add(*scan);
    if (const auto* sample = std::get_if<ImuSample>(&packet)) {
      imu_check_.add(*sample, [](const ImuSample&) {});
      if (imu_.size() < 20'000) imu_.push_back(*sample);
    }
    if (const auto* fix = std::get_if<GnssFix>(&packet)) add(*fix);
  }

  void report(Inspection& result) const {
    constexpr std::array<const char*, 3> names{"IMU samples", "scans", "GNSS fixes"};
    for (std::size_t i : {1U, 0U, 2U})
      if (times_[i].count() > 0) times_[i].report(names[i], result.facts, result.warnings);
    points_.report(result.facts, result.warnings);
    if (sweep_ > 0) result.facts.emplace_back("sweep", "points measured within up to " + text_of(sweep_, 4) + " s");
    result.facts.emplace_back("ground", text_of_ground(ground_));
    if (!imu_.empty()) report_imu(result);
    if (fixes_ > 0) {
      std::string text = "within " + text_of((high_ - low_).norm(), 1) + " m";
      for (const auto& [quality, count] : qualities_) text += ", " + std::to_string(count) + " " + name(quality);
      result.facts.emplace_back("GNSS", text);
    }
  }

 private:
  void add(const LidarScan& scan) {
    if (ground_.side == GroundSide::unclear) ground_ = find_ground(scan.cloud);
    points_.add(scan.cloud);
    sweep_ = std::max(sweep_, to_seconds(scan.end - scan.time));
  }

  void add(const GnssFix& fix) {
    if (fixes_++ == 0) low_ = high_ = fix.position_ecef;
    low_ = low_.cwiseMin(fix.position_ecef);
    high_ = high_.cwiseMax(fix.position_ecef);
    ++qualities_[fix.quality];
  }

  void report_imu(Inspection& result) const {
    const ImuUnits units = infer_imu_units(imu_);
    result.facts.emplace_back("IMU", units.sentence);
    for (std::string& finding : imu_findings(imu_check_.counts())) result.warnings.push_back(std::move(finding));
    if (units.accel != AccelUnit::metres_per_second_squared)
      result.warnings.emplace_back("the IMU's acceleration does not look like m/s^2");
    if (units.gyro == GyroUnit::degrees_per_second) result.warnings.emplace_back("the IMU's rates look like deg/s");
  }

  static std::string name(GnssQuality quality) {
    constexpr std::array<const char*, 6> names{"none", "2-D", "3-D", "differential", "RTK float", "RTK fixed"};
    return names[static_cast<std::size_t>(quality)];
  }

  std::array<TimeStatistics, 3> times_;
  CloudStatistics points_;
  GroundCheck ground_;
  double sweep_ = 0;
  std::vector<ImuSample> imu_;
  ImuCheck imu_check_;
  std::size_t fixes_ = 0;
  Eigen::Vector3d low_ = Eigen::Vector3d::Zero(), high_ = Eigen::Vector3d::Zero();
  std::map<GnssQuality, std::size_t> qualities_;
};

Inspection inspect_dataset(const std::filesystem::path& path, DatasetOptions options) {
  options.recorded_intensities = true;  // what the files have, not what a map takes of them
  const std::unique_ptr<Dataset> dataset = open_dataset(path, options);
  PacketStatistics statistics;
  while (const auto packet = dataset->next()) statistics.add(*packet);
  const DatasetInfo& info = dataset->info();
  Inspection result{.kind = "data set, " + std::string(name_of(info.kind)), .facts = {}, .warnings = info.warnings};
  for (const SensorInfo& sensor : info.sensors)
    result.facts.emplace_back("from " + sensor.name, sensor.remark.empty() ? "read" : sensor.remark);
  statistics.report(result);
  result.facts.emplace_back("T_body_lidar", text_of_pose(info.T_body_lidar));
  if (info.p_body_antenna)
    result.facts.emplace_back("antenna", text_of_vector(*info.p_body_antenna) + " m, body frame");
  if (const auto truth = dataset->truth())
    add_trajectory("truth", *truth, result);
  else
    result.facts.emplace_back("truth", "none");
  for (const std::string& note : info.notes) result.facts.emplace_back("note", note);
  return result;
}

}  // namespace

Inspection inspect(const std::filesystem::path& path, const DatasetOptions& options) {
  const bool file = std::filesystem::is_regular_file(path) && !recognize(path);
  return file ? inspect_file(path) : inspect_dataset(path, options);
}

std::string to_text(const Inspection& inspection) {
  std::size_t widest = 0;
  for (const auto& fact : inspection.facts) widest = std::max(widest, fact.first.size());
  std::string text = inspection.kind + '\n';
  for (const auto& [name, value] : inspection.facts)
    text += "  " + name + std::string(widest - name.size() + 2, ' ') + value + '\n';
  for (const std::string& warning : inspection.warnings) text += "  ! " + warning + '\n';
  return text;
}

}  // namespace chainslam::datasets
