#include "support/summary.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "chainslam/io/file_system.hpp"

namespace chainslam::support {

using Json = nlohmann::ordered_json;

std::string summary_json(const RunSummary& summary) {
  Json json;
  json["dataset"] = summary.dataset;
  json["interrupted"] = summary.interrupted;
  json["scans"] = summary.scans;
  json["frames"] = {
      {"answered", summary.frames}, {"lost", summary.lost_frames}, {"degenerate", summary.degenerate_frames}};
  json["keyframes"] = summary.keyframes;
  json["sessions"] = summary.sessions;
  json["merges"] = summary.merges;
  json["closures"] = {{"direct", summary.direct_closures}, {"chained", summary.chained_closures}};
  json["refusals"] = summary.refusals.empty() ? Json::object() : Json(summary.refusals);
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
  json["errors"] = Json::object();
  for (const auto& [name, value] : summary.errors) {
    std::string pointer = "/errors/" + name;
    std::ranges::replace(pointer, '.', '/');
    json[Json::json_pointer(pointer)] = value;
  }
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
