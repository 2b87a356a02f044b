#include "merged_map.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <memory>
#include <nlohmann/json.hpp>
#include <utility>

#include "chainslam/factor_graph/noise_model.hpp"

namespace chainslam::lamm {

namespace {

/// Adds a set as the map's next session, at the poses that were found.
void add_session(KeyframeSet& set, const std::vector<SE3d>& poses, Index frame, double odometry_variance,
                 SlamMap& map) {
  const SessionId id{to_index(map.sessions.size())};
  const Index first = to_index(map.keyframes.size());
  map.sessions.push_back({.id = id,
                          .name = set.drive.name,
                          .first_keyframe = first,
                          .keyframes = to_index(set.keyframes.size()),
                          .frame = SessionId{frame},
                          .prior = {}});
  for (std::size_t i = 0; i < set.keyframes.size(); ++i) {
    Keyframe& keyframe = set.keyframes[i];
    keyframe.id = KeyframeId{first + to_index(i)};
    keyframe.session = id;
    keyframe.T_map_body = poses[i];
    if (i > 0) {
      const Index from = set.drive.scans[i - 1].frame, to = set.drive.scans[i].frame;
      const auto noise = NoiseModel<6>::from_covariance(compounded_covariance(set.drive, from, to, odometry_variance));
      map.odometry.push_back({.from = KeyframeId{keyframe.id.value - 1},
                              .to = keyframe.id,
                              .T_from_to = set.drive.pose(from).inverse() * set.drive.pose(to),
                              .sqrt_information = noise.sqrt_information()});
    }
    map.keyframes.push_back(std::move(keyframe));
  }
  for (FrameRecord& record : set.frames) {
    record.session = id;
    map.frames.push_back(record);
  }
}

KeyframeId keyframe_of(const SlamMap& map, const KeyframeSet& set, Index session, Index frame) {
  const auto scan = std::ranges::find(set.drive.scans, frame, &Scan::frame);
  return {map.sessions[static_cast<std::size_t>(session)].first_keyframe + to_index(scan - set.drive.scans.begin())};
}

void add_loops(const std::vector<Loop>& loops, const std::vector<KeyframeSet>& sets, double variance, SlamMap& map) {
  const auto noise = NoiseModel<6>::from_sigma(std::sqrt(variance));
  for (const Loop& loop : loops) {
    LoopClosure closure{
        .from = keyframe_of(map, sets[static_cast<std::size_t>(loop.target)], loop.target, loop.target_frame),
        .to = keyframe_of(map, sets[static_cast<std::size_t>(loop.source)], loop.source, loop.source_frame),
        .T_from_to = loop.T_target_source,
        .kind = loop.source == loop.target ? ClosureKind::direct : ClosureKind::merge,
        .mean_squared_error = loop.mean_squared_residual,
        .inlier_ratio = loop.overlap};
    if (loop.kept)
      closure.sqrt_information = noise.sqrt_information();
    else
      closure.verdict = ClosureVerdict::inconsistent;
    (loop.kept ? map.closures : map.refusals).push_back(closure);
  }
}

Index joined_sessions(const OptimizedDrives& drives) {
  Index joined = 0;
  for (std::size_t i = 0; i < drives.frame_of.size(); ++i) joined += drives.frame_of[i] != to_index(i) ? 1 : 0;
  return joined;
}

const char* name_of(OptimizeStatus status) {
  switch (status) {
    case OptimizeStatus::converged:
      return "converged";
    case OptimizeStatus::iteration_limit:
      return "iteration_limit";
    case OptimizeStatus::stalled:
      return "stalled";
    case OptimizeStatus::unconstrained:
      return "unconstrained";
    case OptimizeStatus::singular:
      return "singular";
    case OptimizeStatus::diverged:
      return "diverged";
    case OptimizeStatus::not_finite:
      return "not_finite";
  }
  return "unknown";
}

}  // namespace

mapper::MappingResult mapping_result(std::vector<KeyframeSet> sets, const Result& result,
                                     const ScanGraphOptions& graph) {
  mapper::MappingResult mapping;
  SlamMap map;
  for (std::size_t i = 0; i < sets.size(); ++i) {
    KeyframeSet& set = sets[i];
    add_session(set, result.drives.poses[i], result.drives.frame_of[i], graph.odometry_variance, map);
    mapper::SessionRun& run = mapping.sessions.emplace_back();
    run.id = map.sessions.back().id;
    run.name = set.drive.name;
    run.odometry = set.drive.odometry;
    run.scans = set.drive.frames();
    run.truth = std::move(set.truth);
    run.notes = std::move(set.notes);
    mapping.truths_share_frame &= !set.truth_frame.empty() && set.truth_frame == sets.front().truth_frame;
  }
  add_loops(result.loops, sets, graph.loop_variance, map);
  mapping.map = std::make_shared<const SlamMap>(std::move(map));
  mapping.figures.alignments = to_index(result.loops.size());
  mapping.figures.merges = joined_sessions(result.drives);
  mapping.figures.optimizations = 1;
  if (!result.drives.report.ok()) {
    mapping.figures.failed_optimizations = 1;
    mapping.notes.push_back(std::string("the pose graph was not optimized: ") + name_of(result.drives.report.status));
  }
  return mapping;
}

std::string lamm_json(const Result& result, const Options& options, bool as_released) {
  const auto count = [&](bool within, bool kept_only) {
    return std::ranges::count_if(result.loops, [&](const Loop& loop) {
      return (loop.source == loop.target) == within && (loop.kept || !kept_only);
    });
  };
  const auto loops = [&](bool within) {
    return nlohmann::ordered_json{{"verified", count(within, false)}, {"kept", count(within, true)}};
  };
  const Counts& counts = result.counts;
  const OptimizeReport& report = result.drives.report;
  const nlohmann::ordered_json json = {
      {"as_released", as_released},
      {"key_cloud_max_scans", options.clouds.max_scans},
      {"key_cloud_max_length_m", options.clouds.max_length},
      {"key_cloud_spacing_m", options.clouds.spacing},
      {"key_clouds", counts.key_clouds},
      {"keypoints", counts.keypoints},
      {"triangles", counts.triangles},
      {"session_pairs", counts.pairs},
      {"loops", {{"within_sessions", loops(true)}, {"between_sessions", loops(false)}}},
      {"graph",
       {{"variables", result.drives.variables},
        {"factors", result.drives.factors},
        {"status", name_of(report.status)},
        {"iterations", report.iterations},
        {"initial_cost", report.initial_cost},
        {"final_cost", report.final_cost}}},
      {"describe_s", counts.describe_seconds},
      {"search_s", counts.search_seconds},
      {"optimize_s", counts.optimize_seconds}};
  return json.dump(2) + '\n';
}

}  // namespace chainslam::lamm
