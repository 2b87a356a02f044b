#include "support/summary.hpp"

#include <algorithm>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <numbers>

#include "chainslam/io/atomic_file.hpp"

namespace chainslam::support {

namespace {

using Json = nlohmann::ordered_json;

/// Figures by their names, of which each dot is a level.
template <class Number>
Json levels_json(const std::map<std::string, Number>& figures) {
  Json json = Json::object();
  for (const auto& [name, value] : figures) {
    std::string pointer = "/" + name;
    std::ranges::replace(pointer, '.', '/');
    json[Json::json_pointer(pointer)] = value;
  }
  return json;
}

template <class Map>
Json object_of(const Map& map) {
  return map.empty() ? Json::object() : Json(map);
}

Json spread_json(const Spread& spread, const std::string& unit, double factor) {
  return {
      {"p50" + unit, factor * spread.p50}, {"p99" + unit, factor * spread.p99}, {"max" + unit, factor * spread.max}};
}

Json health_json(const SessionSummary& session) {
  const SessionHealth& health = session.health;
  Json json{{"frames", health.frames},
            {"lost", health.lost},
            {"degenerate", health.degenerate},
            {"map_restarts", health.restarts}};
  if (!session.loaded) json["lost_share"] = session.lost_share();
  if (const ImuUseCounts& use = health.imu_use; use.frames() > 0)
    json["imu_use"] = {{"all", use.share(use.all)},
                       {"gyroscope", use.share(use.gyroscope)},
                       {"scans_only", use.share(use.scans_only)}};
  json["intervals"] = Json::array();
  for (const FrameInterval& interval : health.intervals)
    json["intervals"].push_back({{"cause", name_of(interval.concern)},
                                 {"begin_s", interval.begin},
                                 {"end_s", interval.end},
                                 {"scans", interval.frames},
                                 {"map_restarts", interval.restarts},
                                 {"distance_m", interval.distance}});
  json["contradicted_steps"] = Json::array();
  for (const OdometryFailure& failure : session.failures)
    json["contradicted_steps"].push_back({{"begin_s", failure.begin},
                                          {"end_s", failure.end},
                                          {"distance_m", failure.distance},
                                          {"off_m", failure.off},
                                          {"off_deg", failure.turned * 180 / std::numbers::pi},
                                          {"squared_error", failure.squared_error}});
  return json;
}

Json rotation_json(const SO3d& R) {
  const Eigen::Vector3d angles = roll_pitch_yaw_deg(R);
  const Eigen::Quaterniond q = R.quaternion();
  return {{"roll_pitch_yaw_deg", {angles.x(), angles.y(), angles.z()}},
          {"quaternion_xyzw", {q.x(), q.y(), q.z(), q.w()}}};
}

void add_calibration(const ImuCalibration& calibration, Json& json) {
  constexpr double degrees_in_radian = 180 / std::numbers::pi;
  const ImuAlignmentEstimate& found = calibration.found;
  json["time_offset"] = calibration.found_time_offset();
  json["time_offset_deviation"] = found.time_offset_deviation;
  json["time_offset_known"] = found.time_known;
  json["time_offset_applied"] = calibration.applied_time_offset();
  if (calibration.clock_corrected) json["time_offset_applied_from_s"] = *calibration.clock_corrected;
  json["scan_time_deviation"] = calibration.scan_time_deviation;
  json["rotation"] = rotation_json(found.R_body_lidar);
  json["rotation"]["deviation_deg"] = degrees_in_radian * rotation_deviation(found);
  json["rotation_known"] = found.rotation_known;
  json["rotation_contradicted"] = found.contradicted;
  json["rotation_applied"] = rotation_json(calibration.applied_T_body_lidar().rotation());
  if (calibration.axes_corrected) json["rotation_applied_from_s"] = *calibration.axes_corrected;
  json["seconds_used"] = found.seconds_used;
}

Json session_json(const SessionSummary& session) {
  Json json{{"name", session.name},
            {"loaded", session.loaded},
            {"frame", session.frame},
            {"keyframes", session.keyframes},
            {"path_length_m", session.path_length},
            {"data_seconds", session.data_seconds},
            {"health", health_json(session)}};
  if (session.loaded) return json;
  json["scans"] = session.scans;
  json["frames"] = {
      {"answered", session.frames}, {"lost", session.lost_frames}, {"degenerate", session.degenerate_frames}};
  json["errors"] = levels_json(session.errors);
  if (!session.imu.empty()) json["imu"] = levels_json(session.imu);
  if (session.calibration) add_calibration(*session.calibration, json["imu"]);
  json["notes"] = session.notes;
  return json;
}

Json components_json(const ComponentSummary& components) {
  Json json{{"count", components.count},
            {"keyframes", components.keyframes},
            {"largest", components.largest},
            {"widest_m", components.widest}};
  json["histogram"] = Json::array();
  for (const auto& [size, count] : components.histogram)
    json["histogram"].push_back({{"keyframes", size}, {"components", count}});
  return json;
}

Json spacing_json(const SearchSpacing& spacing) {
  Json json{{"radius_m", spacing.radius}, {"intervals", spacing.intervals}};
  if (spacing.intervals == 0) return json;
  json["mean_m"] = spacing.mean;
  json["shortest_m"] = spacing.shortest;
  json["within_radius"] = spacing.within_radius;
  json["kept"] = spacing.kept();
  return json;
}

Json back_end_json(const BackEndSummary& back_end) {
  Json json{{"keyframes", back_end.keyframes},
            {"alignments", back_end.alignments},
            {"optimizations", back_end.optimizations},
            {"failed_optimizations", back_end.failed_optimizations}};
  json["per_keyframe"] = spread_json(back_end.seconds, "_ms", 1e3);
  json["alignments_per_keyframe"] = spread_json(back_end.keyframe_alignments, "", 1);
  json["alignments_per_direct_closure"] = spread_json(back_end.closure_alignments, "", 1);
  return json;
}

}  // namespace

SearchSpacing search_spacing(const std::vector<double>& spacing, double radius) {
  SearchSpacing result{.radius = radius, .intervals = to_index(spacing.size())};
  if (spacing.empty()) return result;
  double sum = 0;
  for (const double way : spacing) sum += way;
  result.mean = sum / static_cast<double>(spacing.size());
  result.shortest = *std::ranges::min_element(spacing);
  result.within_radius = to_index(std::ranges::count_if(spacing, [&](double way) { return way <= radius; }));
  return result;
}

std::string spacing_sentence(const RunSummary& summary) {
  const SearchSpacing& spacing = summary.spacing;
  if (spacing.intervals == 0) return "";
  const ComponentSummary& components = summary.components;
  char text[240];
  std::snprintf(text, sizeof text,
                "%s: %.1f m between two searches on average (%.1f m at least), radius %.4g m; %d component%s of the "
                "adjacency graph, of %d keyframes and %.1f m from the middle at most",
                spacing.kept() ? "kept" : "not kept", spacing.mean, spacing.shortest, spacing.radius, components.count,
                components.count == 1 ? "" : "s", components.largest, components.widest);
  return text;
}

std::string health_sentence(const SessionSummary& session) {
  const Index lost = session.unregistered_scans(), restarts = session.health.restarts;
  if (lost == 0 && restarts == 0) return "";
  const Index scans = std::max(session.scans, session.frames);
  char text[160];
  std::snprintf(text, sizeof text, "%d of %d scans lost (%.*f %%)", lost, scans, 100 * lost < 10 * scans ? 1 : 0,
                100 * session.lost_share());
  std::string sentence = session.name + ": " + text;
  const auto first = std::ranges::find(session.health.intervals, FrameConcern::lost, &FrameInterval::concern);
  if (first != session.health.intervals.end()) {
    std::snprintf(text, sizeof text, " from %.1f s on", first->begin);
    sentence += text;
  }
  if (restarts > 0)
    sentence += ", " + std::to_string(restarts) + " restart" + (restarts > 1 ? "s" : "") + " of the local map";
  const bool for_long = std::ranges::any_of(session.health.intervals, [](const FrameInterval& interval) {
    return interval.concern == FrameConcern::lost && interval.end - interval.begin >= 1;
  });
  const bool serious = restarts > 0 || for_long || session.lost_share() > 0.1;
  return sentence + (serious ? ": the map is not to be trusted there" : ": the poses there are predicted");
}

Verdict verdict_of(const RunSummary& summary) {
  Verdict verdict;
  for (const SessionSummary& session : summary.sessions)
    if (std::string sentence = session.loaded ? "" : health_sentence(session); !sentence.empty())
      verdict.sentences.push_back(std::move(sentence));
  std::string missed;
  for (const GoalResult& goal : summary.goals)
    if (!goal.met) missed += (missed.empty() ? "" : ", ") + goal.name;
  verdict.failed = !missed.empty();
  verdict.headline = verdict.failed ? "failed: missed " + missed : "good";
  for (const std::string& sentence : verdict.sentences) verdict.headline += "; " + sentence;
  return verdict;
}

std::string summary_json(const RunSummary& summary) {
  Json json;
  const Verdict verdict = verdict_of(summary);
  json["verdict"] = {{"good", !verdict.failed}, {"text", verdict.headline}};
  json["dataset"] = summary.dataset;
  json["interrupted"] = summary.interrupted;
  json["scans"] = summary.scans;
  json["frames"] = {
      {"answered", summary.frames}, {"lost", summary.lost_frames}, {"degenerate", summary.degenerate_frames}};
  json["keyframes"] = summary.keyframes;
  json["sessions"] = Json::array();
  for (const SessionSummary& session : summary.sessions) json["sessions"].push_back(session_json(session));
  json["merges"] = summary.merges;
  json["closures"] = {
      {"direct", summary.direct_closures}, {"chained", summary.chained_closures}, {"merge", summary.merge_closures}};
  json["refusals"] = object_of(summary.refusals);
  json["refusals_by_kind"] = object_of(summary.refusals_by_kind);
  json["components"] = components_json(summary.components);
  json["closure_spacing"] = spacing_json(summary.spacing);
  json["back_end"] = back_end_json(summary.back_end);
  json["data_seconds"] = summary.data_seconds;
  json["wall_seconds"] = summary.wall_seconds;
  if (summary.wall_seconds > 0) json["times_real_time"] = summary.data_seconds / summary.wall_seconds;
  json["path_length_m"] = summary.path_length;
  json["peak_memory_bytes"] = summary.peak_memory;
  json["stages"] = Json::object();
  for (const StageTime& stage : summary.stages)
    json["stages"][stage.stage] = {{"count", stage.count},
                                   {"total_s", stage.total},
                                   {"p50_ms", 1e3 * stage.p50},
                                   {"p99_ms", 1e3 * stage.p99},
                                   {"max_ms", 1e3 * stage.max}};
  json["errors"] = levels_json(summary.errors);
  json["goals"] = Json::array();
  for (const GoalResult& goal : summary.goals)
    json["goals"].push_back({{"name", goal.name}, {"bound", goal.bound}, {"value", goal.value}, {"met", goal.met}});
  json["notes"] = summary.notes;
  // Names come from files: what is not UTF-8 in them is replaced, not thrown at the end of a long run.
  return json.dump(2, ' ', true, Json::error_handler_t::replace) + "\n";
}

void write_summary(const FileTarget& target, const RunSummary& summary) {
  AtomicFile file(target);
  file.write(summary_json(summary));
  file.commit();
}

}  // namespace chainslam::support
