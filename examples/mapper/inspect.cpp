#include "datasets/inspect.hpp"

#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "chainslam/core/error.hpp"
#include "datasets/odometry_recording.hpp"
#include "exit_code.hpp"
#include "inspect_imu.hpp"
#include "map_file.hpp"
#include "map_inspect.hpp"
#include "options.hpp"
#include "summary_file.hpp"
#include "support/interrupt.hpp"
#include "unfinished_run.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

namespace {

namespace fs = std::filesystem;

/// Whether a folder holds the results of a run of `chainslam map`. Recorded odometry has a summary as well.
bool is_map(const fs::path& path) {
  return fs::is_regular_file(path / "summary.json") && !fs::exists(path / datasets::recording_description);
}

/// What the files of a map say, one after the other.
datasets::Inspection inspect_map(const fs::path& path) {
  datasets::Inspection result{
      .kind = "map made by chainslam", .facts = read_summary(path / "summary.json"), .warnings = {}};
  for (const char* name : {"trajectory.tum", "odometry.tum", "graph.g2o", "map.ply"}) {
    if (!fs::is_regular_file(path / name)) {
      result.warnings.push_back(std::string(name) + " is missing");
      continue;
    }
    datasets::Inspection part = datasets::inspect(path / name);
    for (const auto& [fact, text] : part.facts) result.facts.emplace_back(std::string(name) + ": " + fact, text);
    for (const std::string& warning : part.warnings) result.warnings.push_back(std::string(name) + ": " + warning);
  }
  return result;
}

/// What was found, for programs; of a run's folder with the whole summary.
/// @param closures  of which map to list them; null: of none
std::string to_json(const fs::path& path, const datasets::Inspection& found, bool map_folder, const SlamMap* closures) {
  nlohmann::ordered_json json{{"path", path.native()}, {"kind", found.kind}};
  json["facts"] = nlohmann::ordered_json::array();
  for (const auto& [name, value] : found.facts) json["facts"].push_back({{"name", name}, {"value", value}});
  json["warnings"] = found.warnings;
  if (map_folder) json["summary"] = nlohmann::ordered_json::parse(read_summary_text(path / "summary.json"));
  if (closures != nullptr) json["closures"] = closures_json(*closures);
  return json.dump(2, ' ', true, nlohmann::ordered_json::error_handler_t::replace);
}

/// @param map_file  whose closures are listed if they are asked for
void print(const InspectArguments& arguments, const datasets::Inspection& found, const fs::path& map_file = {},
           bool map_folder = false) {
  std::optional<LoadedMap> map;
  if (arguments.closures) map = open_map(map_file, {.recover = true, .scans = false});
  if (arguments.json) {
    std::printf("%s\n", to_json(arguments.path, found, map_folder, map ? &map->map : nullptr).c_str());
    return;
  }
  std::printf("%s: %s", printable(arguments.path.native()).c_str(), printable(to_text(found), true).c_str());
  if (map) print_closures(map->map);
}

}  // namespace

int run(const InspectArguments& arguments) {
  if (is_map_file(arguments.path)) {
    print(arguments, inspect_map_file(arguments.path), arguments.path);
    return exit_good;
  }
  MapperOptions options;
  configure(options, arguments.config, arguments.overrides);
  const bool map = is_map(arguments.path);
  if (arguments.closures && !map)
    throw_input_error(arguments.path.string(), "", "no map, so no closures",
                      "give a map file (.cslam), or a folder that `chainslam map` wrote");
  datasets::Inspection found = map ? inspect_map(arguments.path) : datasets::inspect(arguments.path, options.dataset);
  bool interrupted = false;
  if (!map && arguments.imu_seconds > 0 && datasets::recognize(arguments.path)) {
    const support::Interrupt interrupt;
    inspect_imu(arguments.path, options, arguments.imu_seconds, interrupt.token(), found);
    interrupted = interrupt.requested();
  }
  print(arguments, found, arguments.path / map_name, map);
  return interrupted ? exit_interrupted : exit_good;
}

}  // namespace chainslam::mapper
