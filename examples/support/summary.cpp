#include "support/summary.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "chainslam/io/file_system.hpp"

namespace chainslam::support {

namespace {

using Json = nlohmann::ordered_json;

Json errors_json(const std::map<std::string, double>& errors) {
  Json json = Json::object();
  for (const auto& [name, value] : errors) {
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

Json session_json(const SessionSummary& session) {
  Json json{{"name", session.name},
            {"loaded", session.loaded},
            {"frame", session.frame},
            {"keyframes", session.keyframes},
            {"path_length_m", session.path_length},
            {"data_seconds", session.data_seconds}};
  if (session.loaded) return json;
  json["scans"] = session.scans;
  json["frames"] = {
      {"answered", session.frames}, {"lost", session.lost_frames}, {"degenerate", session.degenerate_frames}};
  json["errors"] = errors_json(session.errors);
  json["notes"] = session.notes;
  return json;
}

Json components_json(const ComponentSummary& components) {
  Json json{{"count", components.count}, {"keyframes", components.keyframes}, {"largest", components.largest}};
  json["histogram"] = Json::array();
  for (const auto& [size, count] : components.histogram)
    json["histogram"].push_back({{"keyframes", size}, {"components", count}});
  return json;
}

Json back_end_json(const BackEndSummary& back_end) {
  Json json{{"keyframes", back_end.keyframes},
            {"alignments", back_end.alignments},
            {"optimisations", back_end.optimisations},
            {"failed_optimisations", back_end.failed_optimisations}};
  json["per_keyframe"] = spread_json(back_end.seconds, "_ms", 1e3);
  json["alignments_per_keyframe"] = spread_json(back_end.keyframe_alignments, "", 1);
  json["alignments_per_direct_closure"] = spread_json(back_end.closure_alignments, "", 1);
  return json;
}

}  // namespace

std::string summary_json(const RunSummary& summary) {
  Json json;
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
  json["errors"] = errors_json(summary.errors);
  json["goals"] = Json::array();
  for (const GoalResult& goal : summary.goals)
    json["goals"].push_back({{"name", goal.name}, {"bound", goal.bound}, {"value", goal.value}, {"met", goal.met}});
  json["notes"] = summary.notes;
  // Names come from files: what is not UTF-8 in them is replaced, not thrown at the end of a long run.
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

void write_summary(const std::filesystem::path& path, const RunSummary& summary) {
  AtomicFile file(path);
  file.write(summary_json(summary));
  file.commit();
}

}  // namespace chainslam::support
