#include <algorithm>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <system_error>
#include <tuple>
#include <utility>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/io/input_journal.hpp"
#include "chainslam/io/map_archive.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "console.hpp"
#include "end_on_interrupt.hpp"
#include "exit_code.hpp"
#include "map_export.hpp"
#include "map_file.hpp"
#include "mapping.hpp"
#include "output.hpp"
#include "saved_settings.hpp"
#include "support/progress.hpp"
#include "support/statistics.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

namespace {

namespace fs = std::filesystem;

/// One of the maps that are merged.
struct MergedMap {
  fs::path path;
  LoadedMap loaded;
  std::tuple<Timestamp, Index, std::uint64_t> rank;  ///< smaller comes first, whatever the order of the arguments
};

/// By the earliest keyframe, then by size, then by content.
std::tuple<Timestamp, Index, std::uint64_t> rank_of(const SlamMap& map, const fs::path& path) {
  const auto earliest = std::ranges::min_element(map.keyframes, {}, &Keyframe::time);
  return {earliest->time, -to_index(map.keyframes.size()), content_of(path)};
}

MergedMap open_one(const fs::path& path, const std::shared_ptr<ScanCache>& scans) {
  MergedMap map{path, open_map(path, {.scan_cache = scans}), {}};
  const std::vector<Keyframe>& keyframes = map.loaded.map.keyframes;
  if (keyframes.empty()) throw_input_error(path.string(), "", "a map without keyframes", "leave it out");
  if (std::ranges::none_of(keyframes, [](const Keyframe& keyframe) { return keyframe.cloud != nullptr; }))
    throw_input_error(path.string(), "", "no scans, without which its sessions match nothing",
                      "give the map that has them");
  map.rank = rank_of(map.loaded.map, path);
  return map;
}

std::vector<MergedMap> open_maps(const std::vector<fs::path>& paths) {
  const auto scans = std::make_shared<ScanCache>();
  std::vector<MergedMap> maps;
  for (const fs::path& path : paths) maps.push_back(open_one(path, scans));
  std::ranges::sort(maps, {}, &MergedMap::rank);
  return maps;
}

DistinctSessions sessions_of(const std::vector<MergedMap>& maps) {
  std::vector<const SlamMap*> all;
  for (const MergedMap& map : maps) all.push_back(&map.loaded.map);
  return distinct_sessions(all);
}

const Session& session_at(const std::vector<MergedMap>& maps, const SessionPlace& place) {
  return maps[place.map].loaded.map.sessions[static_cast<std::size_t>(place.session.value)];
}

std::string name_of(const std::vector<MergedMap>& maps, const SessionPlace& place) {
  const std::string& name = session_at(maps, place).name;
  return "session " + std::to_string(place.session.value) + (name.empty() ? "" : " (" + name + ")") + " of " +
         maps[place.map].path.native();
}

/// The map that the others are mapped on top of: the first that has any session of its own.
std::size_t base_of(const DistinctSessions& distinct) { return distinct.taken.front().map; }

SavedSettings settings_of(const MergedMap& base, const MergeArguments& arguments) {
  if (arguments.config.empty())
    return saved_settings(base.loaded.parameters, base.path,
                          "merge with the version of chainslam that made the map, or pass --config",
                          arguments.overrides);
  SavedSettings settings;
  configure(settings.options, arguments.config, arguments.overrides);
  settings.text = configuration_text(settings.options);
  return settings;
}

/// What the user should know of the maps whose sessions are mapped on top of the base.
std::vector<std::string> notes_on(const std::vector<MergedMap>& maps, const MergedMap& base, bool settings_given) {
  std::vector<std::string> notes;
  for (const MergedMap& map : maps) {
    if (&map == &base) continue;
    if (!settings_given && map.loaded.parameters != base.loaded.parameters)
      notes.push_back(map.path.native() + ": made with other settings than " + base.path.native() +
                      ", whose settings count; --config and --set give others");
    for (const std::string& note : replay_notes(map.loaded)) notes.push_back(map.path.native() + ": " + note);
    if (!map.loaded.unknown.empty())
      notes.push_back(map.path.native() + ": what a later version of chainslam has added to it is left out");
  }
  return notes;
}

/// The base as it is, unless another map has more of one of its sessions, and all other sessions on top of it.
std::shared_ptr<const SlamMap> merge(const std::vector<MergedMap>& maps, const DistinctSessions& distinct,
                                     const MappingRun& run) {
  const std::size_t base = base_of(distinct);
  const bool whole =
      std::ranges::none_of(distinct.left_out, [&](const RepeatedSession& one) { return one.left_out.map == base; });
  std::vector<ReplayedSession> replayed;
  for (const SessionPlace& place : distinct.taken)
    if (!whole || place.map != base) replayed.push_back({&maps[place.map].loaded.map, place.session});
  return map_onto(whole ? maps[base].loaded.map : SlamMap(), replayed, run);
}

void print_sessions(const std::vector<MergedMap>& maps, const DistinctSessions& distinct, const SlamMap& merged) {
  std::printf("maps         %zu with %zu different sessions\n", maps.size(), distinct.taken.size());
  for (const RepeatedSession& one : distinct.left_out)
    std::printf("left out     %s: %d keyframes, of which %s has %d\n", printable(name_of(maps, one.left_out)).c_str(),
                session_at(maps, one.left_out).keyframes, printable(name_of(maps, one.taken)).c_str(),
                session_at(maps, one.taken).keyframes);
  std::printf("sessions     %s\n", sessions_account(merged).c_str());
  for (std::size_t i = 0; i < merged.sessions.size(); ++i)
    std::printf("             %zu: %s, frame %d\n", i, printable(name_of(maps, distinct.taken[i])).c_str(),
                merged.sessions[i].frame.value);
}

}  // namespace

int run(const MergeArguments& arguments) {
  std::vector<fs::path> paths;
  for (const fs::path& given : arguments.maps) paths.push_back(map_path(given));
  for (const fs::path& path : paths)
    if (std::error_code ignored; fs::equivalent(path, arguments.out, ignored))
      throw_output_error(arguments.out.string(), "", "one of the maps that are merged",
                         "choose another name: a map is never changed");
  require_free(arguments.out, arguments.overwrite);
  const EndOnInterrupt interrupt(arguments.out);
  support::Progress progress;
  support::StageTimes times;
  progress.update({.stage = "reading"});
  const std::vector<MergedMap> maps = open_maps(paths);
  const DistinctSessions distinct = sessions_of(maps);
  const MergedMap& base = maps[base_of(distinct)];
  const SavedSettings settings = settings_of(base, arguments);
  progress.finish();
  print_notes("note:", settings.notes);
  print_notes("note:", notes_on(maps, base, !arguments.config.empty()));
  const MappingRun merging{
      .options = settings.options, .threads = to_index(arguments.threads), .progress = progress, .times = times};
  LoadedMap merged{.map = *merge(maps, distinct, merging),
                   .parameters = settings.text,
                   .unknown = base.loaded.unknown,
                   .report = {}};
  Output output(arguments.overwrite);
  if (!output.guarded(arguments.out, [&] { save_map(arguments.out, merged, arguments.overwrite); }))
    return output.exit_code(exit_good);
  print_sessions(maps, distinct, merged.map);
  std::printf("closures     %s\nsaved        %s\nwritten      %s\n", closures_account(merged.map).c_str(),
              short_account(merged.map).c_str(), printable(arguments.out.native()).c_str());
  const bool missed = settings.options.goals.merged && frames_of(merged.map).size() > 1;
  return missed ? exit_goal_missed : exit_good;
}

}  // namespace chainslam::mapper
