#include <cstdio>
#include <filesystem>
#include <memory>
#include <set>
#include <string>
#include <utility>

#include "chainslam/core/error.hpp"
#include "chainslam/slam/closure_descent.hpp"
#include "console.hpp"
#include "end_on_interrupt.hpp"
#include "exit_code.hpp"
#include "map_file.hpp"
#include "output.hpp"
#include "results.hpp"
#include "saved_settings.hpp"
#include "support/frame_health.hpp"
#include "support/progress.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

namespace {

namespace fs = std::filesystem;

/// What a map keeps of a session's run: its frames, or its keyframes where it has no frames.
SessionRun run_of(const SlamMap& map, const Session& session) {
  SessionRun run;
  run.id = session.id;
  run.name = session.name;
  const std::vector<FrameRecord> frames = map.frames.of(session.id);
  run.scans = to_index(frames.size());
  run.odometry = support::odometry_of(frames);
  for (Index i = session.first_keyframe; frames.empty() && i < session.end_keyframe(); ++i) {
    const Keyframe& keyframe = map.keyframes[static_cast<std::size_t>(i)];
    run.odometry.times.push_back(keyframe.time);
    run.odometry.poses.push_back(keyframe.T_odom_body);
  }
  return run;
}

/// Merges that still hold, by the places that were accepted together.
Index merges_in(const SlamMap& map) {
  const detail::Table<Index> events = merge_events(map);
  std::set<Index> merges;
  for (Offset i = 0; i < events.size(); ++i)
    if (events[i] >= 0 && map.closures[static_cast<std::size_t>(i)].verdict != ClosureVerdict::reverted)
      merges.insert(events[i]);
  return to_index(merges.size());
}

std::string title_of(const SlamMap& map) {
  std::string names;
  for (const Session& session : map.sessions) names += (names.empty() ? "" : ", ") + session.name;
  return names;
}

/// Goals that need a ground truth cannot be judged again.
MapperOptions without_truth(MapperOptions options) {
  Goals& goals = options.goals;
  goals.max_ape = goals.min_odometry_ape = goals.min_ape_ratio = goals.max_inter_session_error = 0;
  return options;
}

}  // namespace

int run(const ReportArguments& arguments) {
  const fs::path source = map_path(arguments.map);
  const EndOnInterrupt interrupt;
  OutputFolder folder(arguments.out, arguments.overwrite);
  support::Progress progress;
  progress.update({.stage = "reading"});
  LoadedMap loaded = open_map(source);
  if (loaded.map.keyframes.empty())
    throw_input_error(source.string(), "", "a map without keyframes", "give a map that has some");
  const SavedSettings settings =
      saved_settings(loaded.parameters, source, "make the report with the version of chainslam that made the map");
  const MapperOptions options = without_truth(settings.options);
  MappingResult mapping;
  mapping.map = std::make_shared<const SlamMap>(std::move(loaded.map));
  for (const Session& session : mapping.map->sessions) mapping.sessions.push_back(run_of(*mapping.map, session));
  mapping.figures.merges = merges_in(*mapping.map);
  mapping.notes.emplace_back(
      "made from the map alone: times, memory, IMU calibration and errors against a ground truth, which only the run "
      "knew, are left out");
  const std::string title = title_of(*mapping.map);
  progress.update({.stage = "writing"});
  const RunOutcome outcome = conclude(std::move(mapping), title, options);
  auto report = gather_report(*outcome.mapping.map, options.map_voxel, true);
  write_map_clouds(folder, *outcome.mapping.map, options.map_voxel);
  write_run_report(folder, outcome, report.get());
  const fs::path kept = folder.commit();
  progress.finish();
  print_notes("note:", settings.notes);
  print_verdict(support::verdict_of(outcome.summary), options.odometry_source);
  if (!kept.empty()) std::printf("kept         what was there is now %s\n", printable(kept.native()).c_str());
  std::printf("report       %s\n", printable((folder.target() / "report.html").native()).c_str());
  return folder.exit_code(exit_good);
}

}  // namespace chainslam::mapper
