#include "results.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <numbers>
#include <utility>

#include "chainslam/cloud/transform.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/evaluation/ape.hpp"
#include "chainslam/factor_graph/noise_model.hpp"
#include "chainslam/io/file_system.hpp"
#include "chainslam/io/g2o.hpp"
#include "chainslam/io/kitti.hpp"
#include "chainslam/io/ply.hpp"
#include "chainslam/io/tum.hpp"
#include "chainslam/slam/corrected_trajectory.hpp"
#include "chainslam/trajectory/association.hpp"
#include "support/map_picture.hpp"
#include "support/report.hpp"
#include "support/report_data.hpp"

namespace chainslam::mapper {

namespace {

namespace fs = std::filesystem;

std::optional<TrajectoryErrors> errors_against(const Trajectory& truth, const Trajectory& estimate) {
  const Duration max_gap = seconds(2.0);  // of the truth, over which it is interpolated
  const InterpolatedMatch match = match_interpolated(truth, estimate, max_gap);
  if (match.trajectories.estimate.size() < 3) return std::nullopt;
  TrajectoryErrors errors{ape(match.trajectories.reference, match.trajectories.estimate), match.estimate.total()};
  if (errors.ape.status != EvaluationStatus::evaluated) return std::nullopt;
  return errors;
}

void add_errors(const std::string& name, const AbsolutePoseErrors& errors, support::RunSummary& summary) {
  constexpr double degrees = 180 / std::numbers::pi;
  const auto add = [&](const std::string& part, const ErrorStatistics& statistics, double factor) {
    summary.errors[name + ".ape." + part + ".rmse"] = factor * statistics.rmse;
    summary.errors[name + ".ape." + part + ".mean"] = factor * statistics.mean;
    summary.errors[name + ".ape." + part + ".max"] = factor * statistics.max;
  };
  add("translation", errors.translation, 1);
  add("rotation_deg", errors.rotation, degrees);
  summary.errors[name + ".ape.poses"] = static_cast<double>(errors.translation_errors.size());
}

void judge_goals(const Goals& goals, const RunOutcome& outcome, support::RunSummary& summary) {
  const double none = std::nan("");
  const double odometry = outcome.odometry_errors ? outcome.odometry_errors->ape.translation.rmse : none;
  const double optimised = outcome.optimised_errors ? outcome.optimised_errors->ape.translation.rmse : none;
  const auto at_least = [&](const char* name, double bound, double value) {
    if (bound > 0) summary.goals.push_back({name, bound, value, value >= bound});
  };
  if (goals.max_ape > 0) summary.goals.push_back({"max_ape", goals.max_ape, optimised, optimised <= goals.max_ape});
  at_least("min_odometry_ape", goals.min_odometry_ape, odometry);
  at_least("min_ape_ratio", goals.min_ape_ratio, odometry / optimised);
  at_least("min_closures", goals.min_closures, summary.direct_closures);
}

void write_map(const fs::path& path, const SlamMap& map, double voxel_size) {
  // Folded now and then, so that memory holds the map and not all scans at once.
  constexpr std::size_t fold_at = 8'000'000;
  PointCloud<float> points;
  std::size_t folded = 0;
  for (const Keyframe& keyframe : map.keyframes) {
    if (!keyframe.cloud) continue;
    const PointCloud<float> placed = transformed(keyframe.cloud->positions, keyframe.T_map_body);
    points.positions.insert(points.positions.end(), placed.positions.begin(), placed.positions.end());
    if (points.size() > fold_at + 2 * folded) {
      points = voxel_downsample(points, voxel_size, VoxelMode::first);
      folded = points.size();
    }
  }
  write_ply(path, voxel_downsample(points, voxel_size, VoxelMode::first));
}

void write_graph(const fs::path& path, const SlamMap& map) {
  G2oFile graph;
  const auto add_edge = [&](KeyframeId from, KeyframeId to, const SE3d& T_from_to, const Matrix6d& covariance) {
    graph.spatial.edges.push_back({.from = from.value,
                                   .to = to.value,
                                   .measurement = T_from_to,
                                   .information = NoiseModel<6>::from_covariance(covariance).information()});
  };
  for (const Keyframe& keyframe : map.keyframes)
    graph.spatial.vertices.push_back({keyframe.id.value, keyframe.T_map_body});
  for (const Session& session : map.sessions)
    if (session.keyframes > 0) graph.fixed.push_back(session.first_keyframe);
  for (const OdometryMeasurement& step : map.odometry) add_edge(step.from, step.to, step.T_from_to, step.covariance);
  for (const LoopClosure& closure : map.closures)
    add_edge(closure.from, closure.to, closure.T_from_to, closure.covariance);
  write_g2o(path, graph);
}

std::string pose_fields(const SE3d& T) {
  const auto q = T.rotation().quaternion();
  char text[256];
  std::snprintf(text, sizeof text, "%.9g,%.9g,%.9g,%.12g,%.12g,%.12g,%.12g", T.translation().x(), T.translation().y(),
                T.translation().z(), q.x(), q.y(), q.z(), q.w());
  return text;
}

void write_keyframes(const fs::path& path, const SlamMap& map) {
  AtomicFile file(path);
  file.write(
      std::string_view("id,session,time_ns,x,y,z,qx,qy,qz,qw,odom_x,odom_y,odom_z,odom_qx,odom_qy,odom_qz,"
                       "odom_qw,points,ecef_x,ecef_y,ecef_z\n"));
  for (const Keyframe& keyframe : map.keyframes) {
    std::string line = std::to_string(keyframe.id.value) + ',' + std::to_string(keyframe.session.value) + ',' +
                       std::to_string(keyframe.time.nanoseconds()) + ',' + pose_fields(keyframe.T_map_body) + ',' +
                       pose_fields(keyframe.T_odom_body) + ',' +
                       std::to_string(keyframe.cloud ? keyframe.cloud->size() : 0);
    char text[128] = ",,,";
    if (keyframe.gnss) {
      const Eigen::Vector3d& p = keyframe.gnss->position_ecef;
      std::snprintf(text, sizeof text, ",%.4f,%.4f,%.4f", p.x(), p.y(), p.z());
    }
    file.write(line + text + '\n');
  }
  file.commit();
}

void write_closures(const fs::path& path, const SlamMap& map) {
  AtomicFile file(path);
  file.write(std::string_view("from,to,kind,verdict,mean_squared_error_m2,inlier_ratio,x,y,z,qx,qy,qz,qw\n"));
  for (const auto* closures : {&map.closures, &map.refusals}) {
    for (const LoopClosure& closure : *closures) {
      char text[128];
      std::snprintf(text, sizeof text, "%d,%d,%s,%s,%.6g,%.4f,", closure.from.value, closure.to.value,
                    support::name_of(closure.kind).c_str(), support::name_of(closure.verdict).c_str(),
                    closure.mean_squared_error, closure.inlier_ratio);
      file.write(text + pose_fields(closure.T_from_to) + '\n');
    }
  }
  file.commit();
}

std::string metres(double value) {
  char text[64];
  std::snprintf(text, sizeof text, value < 10 ? "%.3f m" : "%.1f m", value);
  return text;
}

/// The truth at the keyframes, brought into the map's frame by the alignment of the evaluation.
void add_truth(const RunOutcome& outcome, support::ReportSession& session) {
  if (!outcome.truth || !outcome.optimised_errors) return;
  const SE3d T_map_truth = [&] {
    const Sim3d& S = outcome.optimised_errors->ape.S_reference_estimate;
    return SE3d(S.rotation(), S.translation()).inverse();
  }();
  std::vector<Eigen::Vector3d> positions;
  for (const Keyframe& keyframe : outcome.mapping.map->keyframes) {
    const auto pose = pose_at(*outcome.truth, keyframe.time, seconds(2.0));
    if (!pose) return;  // the plots need one for each keyframe
    positions.push_back(T_map_truth * pose->translation());
  }
  session.truth = std::move(positions);
}

}  // namespace

RunOutcome conclude(MappingResult mapping, std::optional<Trajectory> truth, const std::string& dataset,
                    const MapperOptions& options) {
  RunOutcome outcome;
  outcome.trajectory = corrected_trajectory(mapping.odometry, mapping.map->keyframes);
  outcome.truth = std::move(truth);
  if (outcome.truth) {
    outcome.odometry_errors = errors_against(*outcome.truth, mapping.odometry);
    outcome.optimised_errors = errors_against(*outcome.truth, outcome.trajectory);
    if (!outcome.optimised_errors)
      mapping.notes.emplace_back("the truth shares fewer than three poses with the run: no errors are taken");
  }
  support::RunSummary& summary = outcome.summary;
  const SlamMap& map = *mapping.map;
  summary.dataset = dataset;
  summary.interrupted = mapping.interrupted;
  summary.scans = mapping.scans;
  summary.frames = to_index(mapping.health.size());
  const auto count = [&](FrameStatus status) {
    return to_index(std::ranges::count(mapping.health, status, &FrameHealth::status));
  };
  summary.lost_frames = count(FrameStatus::lost);
  summary.degenerate_frames = count(FrameStatus::degenerate);
  summary.keyframes = to_index(map.keyframes.size());
  summary.sessions = to_index(map.sessions.size());
  summary.direct_closures = to_index(std::ranges::count(map.closures, ClosureKind::direct, &LoopClosure::kind));
  summary.chained_closures = to_index(std::ranges::count(map.closures, ClosureKind::chained, &LoopClosure::kind));
  for (const LoopClosure& refusal : map.refusals) ++summary.refusals[support::name_of(refusal.verdict)];
  if (!mapping.odometry.empty())
    summary.data_seconds = to_seconds(mapping.odometry.times.back() - mapping.odometry.times.front());
  summary.path_length = path_length(outcome.trajectory);
  if (outcome.odometry_errors) add_errors("odometry", outcome.odometry_errors->ape, summary);
  if (outcome.optimised_errors) add_errors("optimised", outcome.optimised_errors->ape, summary);
  judge_goals(options.goals, outcome, summary);
  summary.notes = mapping.notes;
  outcome.mapping = std::move(mapping);
  return outcome;
}

void write_results(const fs::path& folder, const RunOutcome& outcome, const MapperOptions& options) {
  const SlamMap& map = *outcome.mapping.map;
  write_tum(folder / "trajectory.tum", outcome.trajectory);
  write_kitti_poses(folder / "trajectory.kitti.txt", outcome.trajectory);
  write_tum(folder / "odometry.tum", outcome.mapping.odometry);
  write_keyframes(folder / "keyframes.csv", map);
  write_closures(folder / "closures.csv", map);
  write_graph(folder / "graph.g2o", map);
  write_map(folder / "map.ply", map, options.map_voxel);
}

void write_run_report(const fs::path& folder, const RunOutcome& outcome, double map_voxel) {
  const support::RunSummary& summary = outcome.summary;
  support::ReportData data = support::report_data(*outcome.mapping.map, map_voxel);
  data.title = summary.dataset;
  data.subtitle = std::to_string(summary.scans) + " scans, " + metres(summary.path_length) + ", " +
                  std::to_string(summary.keyframes) + " keyframes" +
                  (summary.interrupted ? "; interrupted before the data ended" : "");
  for (support::ReportSession& session : data.sessions) add_truth(outcome, session);
  data.figures = {{"Scans", std::to_string(summary.scans), std::to_string(summary.lost_frames) + " lost"},
                  {"Path", metres(summary.path_length), std::to_string(summary.keyframes) + " keyframes"},
                  {"Closures", std::to_string(summary.direct_closures), "loops closed"}};
  if (outcome.optimised_errors)
    data.figures.push_back({"Error", metres(outcome.optimised_errors->ape.translation.rmse),
                            "odometry alone " + metres(outcome.odometry_errors->ape.translation.rmse)});
  char speed[64];
  std::snprintf(speed, sizeof speed, "%.1f x", summary.data_seconds / std::max(summary.wall_seconds, 1e-9));
  data.figures.push_back({"Speed", speed, "times real time"});
  data.warnings = summary.notes;
  for (const support::GoalResult& goal : summary.goals) {
    char text[128];
    std::snprintf(text, sizeof text, "%.4g (bound %.4g), %s", goal.value, goal.bound, goal.met ? "met" : "missed");
    data.summary.emplace_back("goal " + goal.name, text);
  }
  for (const auto& [name, value] : summary.errors) {
    char text[64];
    std::snprintf(text, sizeof text, "%.4g", value);
    data.summary.emplace_back(name, text);
  }
  data.summary.emplace_back("peak memory", std::to_string(summary.peak_memory / 1'000'000) + " MB");
  data.stages = summary.stages;
  data.plots = {support::speed_plot(data.sessions), support::error_plot(data.sessions)};
  std::erase_if(data.plots, [](const support::ReportPlot& plot) { return plot.series.empty(); });
  support::write_report(folder / "report.html", data);
  support::write_map_picture(folder / "map.png", data);
}

}  // namespace chainslam::mapper
