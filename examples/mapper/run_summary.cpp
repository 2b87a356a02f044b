#include "run_summary.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <vector>

#include "support/report_data.hpp"

namespace chainslam::mapper {

namespace {

constexpr double degrees = 180 / std::numbers::pi;

void add_statistics(const std::string& name, const ErrorStatistics& statistics, double factor,
                    std::map<std::string, double>& errors) {
  errors[name + ".rmse"] = factor * statistics.rmse;
  errors[name + ".mean"] = factor * statistics.mean;
  errors[name + ".median"] = factor * statistics.median;
  errors[name + ".max"] = factor * statistics.max;
}

void add_ape(const std::string& name, const ErrorStatistics& translation, const ErrorStatistics& rotation,
             std::map<std::string, double>& errors) {
  add_statistics(name + ".ape.translation", translation, 1, errors);
  add_statistics(name + ".ape.rotation_deg", rotation, degrees, errors);
  errors[name + ".ape.poses"] = translation.count;
}

/// Nothing where the path is too short for them.
void add_kitti(const std::string& name, const KittiErrors& kitti, std::map<std::string, double>& errors) {
  if (kitti.status != EvaluationStatus::evaluated) return;
  errors[name + ".kitti.translation_percent"] = 100 * kitti.translation;
  errors[name + ".kitti.rotation_deg_per_100m"] = 100 * degrees * kitti.rotation;
  errors[name + ".kitti.segments"] = to_index(kitti.segments.size());
}

void add_joint(const std::string& name, const std::optional<JointErrors>& joint,
               std::map<std::string, double>& errors) {
  if (!joint) return;
  add_ape(name, joint->translation, joint->rotation, errors);
  add_kitti(name, joint->kitti, errors);
  errors[name + ".ape.sessions"] = joint->sessions;
  errors[name + ".ape.alignments"] = joint->alignments;
}

support::SessionSummary summary_of(const Session& session) {
  return {.name = session.name,
          .loaded = true,
          .frame = std::max<Index>(session.frame.value, 0),
          .keyframes = session.keyframes};
}

/// What the map alone says of a session that was loaded.
void add_loaded(const SlamMap& map, const Session& session, support::SessionSummary& summary) {
  for (Index i = session.first_keyframe; i + 1 < session.end_keyframe(); ++i) {
    const Keyframe& here = map.keyframes[static_cast<std::size_t>(i)];
    const Keyframe& next = map.keyframes[static_cast<std::size_t>(i + 1)];
    summary.path_length += (next.T_map_body.translation() - here.T_map_body.translation()).norm();
    summary.data_seconds += to_seconds(next.time - here.time);
  }
}

/// Samples of the IMU by what became of them; empty if there were none.
std::map<std::string, std::int64_t> imu_counts(const ImuCheckCounts& imu) {
  if (imu.received == 0) return {};
  return {{"samples", imu.received},
          {"rejected.not_finite", imu.not_finite},
          {"rejected.out_of_range", imu.out_of_range},
          {"rejected.spikes", imu.spikes},
          {"rejected.repeated", imu.repeated},
          {"rejected.out_of_order", imu.out_of_order},
          {"rejected.invalid_times", imu.invalid_times},
          {"rejected.second_imu", imu.second_imu},
          {"stuck.gyroscope", imu.stuck_gyro},
          {"stuck.accelerometer", imu.stuck_accel},
          {"converted.from_g", imu.from_g},
          {"converted.from_degrees", imu.from_degrees}};
}

/// What the run says of a session that it read.
void add_run(const SessionRun& run, const SessionOutcome& outcome, support::SessionSummary& summary) {
  summary.loaded = false;
  summary.scans = run.scans;
  summary.frames = summary.health.frames;
  summary.lost_frames = summary.health.lost;
  summary.degenerate_frames = summary.health.degenerate;
  if (run.odometry.has_times())
    summary.data_seconds = to_seconds(run.odometry.times.back() - run.odometry.times.front());
  summary.path_length = path_length(outcome.trajectory);
  const auto add_errors = [&](const char* name, const std::optional<TrajectoryErrors>& errors) {
    if (!errors) return;
    add_ape(name, errors->ape.translation, errors->ape.rotation, summary.errors);
    add_kitti(name, errors->kitti, summary.errors);
  };
  add_errors("odometry", outcome.odometry_errors);
  add_errors("optimized", outcome.optimized_errors);
  summary.imu = imu_counts(run.imu);
  summary.calibration = run.calibration;
  summary.notes = run.notes;
}

void add_sessions(const RunOutcome& outcome, support::RunSummary& summary) {
  const SlamMap& map = *outcome.mapping.map;
  for (const Session& session : map.sessions) {
    summary.sessions.push_back(summary_of(session));
    summary.sessions.back().health = support::health_of(map.frames.of(session.id));
    summary.sessions.back().failures = support::odometry_failures(map, session);
    const auto run = std::ranges::find(outcome.mapping.sessions, session.id, &SessionRun::id);
    if (run == outcome.mapping.sessions.end()) {
      add_loaded(map, session, summary.sessions.back());
      continue;
    }
    const auto i = static_cast<std::size_t>(run - outcome.mapping.sessions.begin());
    add_run(*run, outcome.sessions[i], summary.sessions.back());
    const support::SessionSummary& added = summary.sessions.back();
    summary.scans += added.scans;
    summary.frames += added.frames;
    summary.lost_frames += added.lost_frames;
    summary.degenerate_frames += added.degenerate_frames;
    summary.data_seconds += added.data_seconds;
    summary.path_length += added.path_length;
    for (const std::string& note : run->notes)
      summary.notes.push_back(outcome.mapping.sessions.size() > 1 ? run->name + ": " + note : note);
  }
}

/// Metres from a component's middle to the farthest of its keyframes.
double reach_of(const support::ReportComponent& component, const SlamMap& map) {
  const auto position = [&](Index keyframe) -> const Eigen::Vector3d& {
    return map.keyframes[static_cast<std::size_t>(keyframe)].T_map_body.translation();
  };
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const Index keyframe : component.keyframes) middle += position(keyframe);
  middle /= static_cast<double>(component.keyframes.size());
  double reach = 0;
  for (const Index keyframe : component.keyframes) reach = std::max(reach, (position(keyframe) - middle).norm());
  return reach;
}

void add_closures(const SlamMap& map, support::RunSummary& summary) {
  const auto count = [&](ClosureKind kind) {
    return to_index(std::ranges::count(map.closures, kind, &LoopClosure::kind));
  };
  summary.direct_closures = count(ClosureKind::direct);
  summary.chained_closures = count(ClosureKind::chained);
  summary.merge_closures = count(ClosureKind::merge);
  for (const LoopClosure& refusal : map.refusals) {
    const std::string reason = support::name_of(refusal.verdict);
    ++summary.refusals[reason];
    ++summary.refusals_by_kind[support::name_of(refusal.kind)][reason];
  }
  for (const support::ReportComponent& component : support::adjacency_components(map)) {
    const Index size = to_index(component.keyframes.size());
    ++summary.components.count;
    ++summary.components.histogram[size];
    summary.components.keyframes += size;
    summary.components.largest = std::max(summary.components.largest, size);
    summary.components.widest = std::max(summary.components.widest, reach_of(component, map));
  }
}

/// Registrations that each accepted direct closure took: its own, and those of the chain that it caused.
std::vector<double> alignments_per_closure(const SlamMap& map) {
  std::vector<double> by_position(map.closures.size(), 1.0);
  for (const auto* closures : {&map.closures, &map.refusals})
    for (const LoopClosure& closure : *closures)
      if (closure.kind == ClosureKind::chained && closure.cause >= 0 && closure.cause < std::ssize(by_position))
        ++by_position[static_cast<std::size_t>(closure.cause)];
  std::vector<double> direct;
  for (std::size_t i = 0; i < by_position.size(); ++i)
    if (map.closures[i].kind == ClosureKind::direct) direct.push_back(by_position[i]);
  return direct;
}

void add_back_end(const MappingResult& mapping, support::RunSummary& summary) {
  const BackEndFigures& figures = mapping.figures;
  summary.merges = figures.merges;
  summary.spacing = support::search_spacing(figures.search_spacing, figures.closure_radius);
  summary.back_end = {.optimizations = figures.optimizations,
                      .failed_optimizations = figures.failed_optimizations,
                      .alignments = figures.alignments,
                      .keyframes = to_index(figures.keyframe_seconds.size())};
  summary.back_end.seconds = support::spread_of(figures.keyframe_seconds);
  summary.back_end.keyframe_alignments =
      support::spread_of({figures.keyframe_alignments.begin(), figures.keyframe_alignments.end()});
  summary.back_end.closure_alignments = support::spread_of(alignments_per_closure(*mapping.map));
}

void judge(const Goals& goals, const RunOutcome& outcome, support::RunSummary& summary) {
  const double none = std::nan("");
  const double odometry = outcome.odometry_errors ? outcome.odometry_errors->translation.rmse : none;
  const double optimized = outcome.optimized_errors ? outcome.optimized_errors->translation.rmse : none;
  const double between = outcome.inter_session_errors ? outcome.inter_session_errors->translation.rmse : none;
  const auto at_least = [&](const char* name, double bound, double value) {
    if (bound > 0) summary.goals.push_back({name, bound, value, value >= bound});
  };
  const auto at_most = [&](const char* name, double bound, double value) {
    if (bound > 0) summary.goals.push_back({name, bound, value, value <= bound});
  };
  at_most("max_ape", goals.max_ape, optimized);
  at_least("min_odometry_ape", goals.min_odometry_ape, odometry);
  at_least("min_ape_ratio", goals.min_ape_ratio, odometry / optimized);
  at_least("min_closures", goals.min_closures, summary.direct_closures);
  at_least("min_chained_closures", goals.min_chained_closures, summary.chained_closures);
  at_most("max_inter_session_error", goals.max_inter_session_error, between);
  double lost_share = 0, restarts = 0;
  for (const support::SessionSummary& session : summary.sessions) {
    if (session.loaded) continue;
    lost_share = std::max(lost_share, session.lost_share());
    restarts = std::max(restarts, static_cast<double>(session.health.restarts));
  }
  if (goals.max_lost_share < 1)
    summary.goals.push_back({"max_lost_share", goals.max_lost_share, lost_share, lost_share <= goals.max_lost_share});
  if (goals.max_map_restarts >= 0)
    summary.goals.push_back({"max_map_restarts", static_cast<double>(goals.max_map_restarts), restarts,
                             restarts <= goals.max_map_restarts});
  if (!goals.merged) return;
  const auto frames = std::ranges::count_if(outcome.mapping.map->sessions,
                                            [](const Session& session) { return session.frame == session.id; });
  summary.goals.push_back({"merged", 1, static_cast<double>(frames), frames == 1});
}

}  // namespace

void summarize(RunOutcome& outcome, const std::string& dataset, const Goals& goals) {
  support::RunSummary& summary = outcome.summary;
  const SlamMap& map = *outcome.mapping.map;
  summary.dataset = dataset;
  summary.interrupted = outcome.mapping.interrupted;
  summary.keyframes = to_index(map.keyframes.size());
  summary.notes = outcome.mapping.notes;
  add_sessions(outcome, summary);
  add_closures(map, summary);
  add_back_end(outcome.mapping, summary);
  add_joint("odometry", outcome.odometry_errors, summary.errors);
  add_joint("optimized", outcome.optimized_errors, summary.errors);
  if (const auto& errors = outcome.inter_session_errors) {
    add_statistics("inter_session.rpe.translation", errors->translation, 1, summary.errors);
    add_statistics("inter_session.rpe.rotation_deg", errors->rotation, degrees, summary.errors);
    summary.errors["inter_session.rpe.pairs"] = errors->translation.count;
  }
  judge(goals, outcome, summary);
}

}  // namespace chainslam::mapper
