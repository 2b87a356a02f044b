#include <algorithm>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/io/atomic_file.hpp"
#include "chainslam/io/input_journal.hpp"
#include "chainslam/io/map_archive.hpp"
#include "console.hpp"
#include "datasets/dataset.hpp"
#include "exit_code.hpp"
#include "map_file.hpp"
#include "mapping.hpp"
#include "options.hpp"
#include "output.hpp"
#include "results.hpp"
#include "session_workers.hpp"
#include "simulated_dataset.hpp"
#include "support/interrupt.hpp"
#include "support/progress.hpp"
#include "support/summary.hpp"
#include "trajectory_file.hpp"
#include "unfinished_run.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

namespace {

namespace fs = std::filesystem;

using Datasets = std::vector<std::unique_ptr<datasets::Dataset>>;

/// All are opened before the first is mapped, so that a wrong path is not found out an hour later.
Datasets open_datasets(const MapArguments& arguments, const MapperOptions& options) {
  Datasets datasets;
  for (const fs::path& path : arguments.data) {
    auto simulated = open_simulation(path.string());
    datasets.push_back(simulated ? std::move(simulated) : datasets::open_dataset(path, options.dataset));
  }
  return datasets;
}

std::vector<std::optional<Trajectory>> read_truths(const MapArguments& arguments, const Datasets& datasets) {
  if (!arguments.truths.empty() && arguments.truths.size() != datasets.size())
    throw support::ConfigError(
        "--truth", "each data set needs one, or none has any",
        std::to_string(arguments.truths.size()) + " files for " + std::to_string(datasets.size()) + " data sets",
        "give one for each, in their order");
  std::vector<std::optional<Trajectory>> truths;
  for (std::size_t i = 0; i < datasets.size(); ++i)
    truths.push_back(arguments.truths.empty() ? datasets[i]->truth()
                                              : std::optional(read_trajectory(arguments.truths[i]).trajectory));
  return truths;
}

/// Saved maps, given by their file or by the folder of results that holds it.
struct SavedMaps {
  std::vector<SlamMap> maps;
  std::vector<LoadedReference> references;  ///< for whoever does the run's work again
};

SavedMaps load_maps(const MapArguments& arguments, std::uint64_t max_memory, const std::shared_ptr<ScanCache>& scans) {
  SavedMaps saved;
  for (const fs::path& given : arguments.maps) {
    const fs::path path = map_path(given);
    saved.maps.push_back(open_map(path, {.max_memory = max_memory, .scan_cache = scans}).map);
    saved.references.push_back({fs::absolute(path).string(), content_of(path)});
  }
  return saved;
}

std::string title(const Datasets& datasets) {
  std::string names;
  for (const auto& dataset : datasets) {
    const datasets::DatasetInfo& info = dataset->info();
    names += (names.empty() ? "" : ", ") + info.name + (info.source.empty() ? "" : " (" + info.source + ")");
  }
  return names;
}

void write_text(const FileTarget& target, const std::string& text) {
  AtomicFile file(target);
  file.write(text);
  file.commit();
}

IoError without_use(const SessionRun& session, const fs::path& data) {
  return {IoError::Kind::input,
          {data.string(), "", std::to_string(session.scans) + " scans, none of which could be used",
           "run `chainslam inspect` on it; compare odometry.min_range and max_range with the scans' ranges"}};
}

/// Says which data sets came to nothing, where others did not. @returns whether any did.
bool has_empty_session(const MappingResult& mapping, const MapArguments& arguments) {
  bool any = false;
  for (std::size_t i = 0; i < mapping.sessions.size(); ++i) {
    if (mapping.interrupted || !mapping.sessions[i].odometry.empty()) continue;
    std::fprintf(stderr, "error: %s\n",
                 printable(without_use(mapping.sessions[i], arguments.data[i]).what(), true).c_str());
    any = true;
  }
  return any;
}

[[noreturn]] void throw_without_keyframes(const MappingResult& mapping, const MapArguments& arguments) {
  if (mapping.failure) throw IoError(*mapping.failure);
  throw without_use(mapping.sessions.front(), arguments.data.front());
}

/// What helps a run that needed more memory than it may have.
std::string memory_remedy(bool at_once, const fs::path& out) {
  if (at_once) return "allow more, or load smaller maps: the limit does not suffice for one keyframe";
  return "the map so far is saved: continue with --load " + printable((out / map_name).native()) +
         " where there is more, or raise keyframes.distance or keyframes.voxel_size";
}

/// Whatever ends mapping before its time, what the back end was given is kept, and the user learns how to get it.
MappingResult map_or_say_what_is_left(const Datasets& datasets, std::vector<SlamMap> saved, const MappingRun& run,
                                      const OutputFolder& folder, const InputJournal<>& input) {
  try {
    return run_mapping(datasets, std::move(saved), run);
  } catch (...) {
    run.progress.finish();
    if (input.keyframes() > 0)
      std::fprintf(stderr, "note: %d keyframes are kept: `chainslam recover %s -o NEW.cslam` makes the map of them\n",
                   input.keyframes(), printable(folder.path().native()).c_str());
    throw;
  }
}

/// In how many frames the sessions of a map lie: 1 if all are merged.
Index frames(const SlamMap& map) {
  return to_index(
      std::ranges::count_if(map.sessions, [](const Session& session) { return session.frame == session.id; }));
}

void print_outcome(const RunOutcome& outcome, const OutputFolder& folder, const fs::path& kept,
                   OdometrySourceKind source) {
  const support::RunSummary& summary = outcome.summary;
  const SlamMap& map = *outcome.mapping.map;
  const support::Verdict verdict = support::verdict_of(summary);
  print_verdict(verdict, source);
  std::printf("scans        %d (%d lost, %d degenerate)\n", summary.scans, summary.lost_frames,
              summary.degenerate_frames);
  print_imu(summary);
  std::printf("keyframes    %d over %.1f m\n", summary.keyframes, summary.path_length);
  if (map.sessions.size() > 1)
    std::printf("sessions     %zu in %d frame%s\n", map.sessions.size(), frames(map), frames(map) == 1 ? "" : "s");
  const auto count = [&](ClosureKind kind) {
    return to_index(std::ranges::count(map.closures, kind, &LoopClosure::kind));
  };
  std::printf("closures     %d direct, %d chained, %d merge\n", count(ClosureKind::direct), count(ClosureKind::chained),
              count(ClosureKind::merge));
  for (const auto& [reason, refused] : summary.refusals)
    std::printf("             %d refused: %s\n", refused, reason.c_str());
  if (const std::string spacing = support::spacing_sentence(summary); !spacing.empty())
    std::printf("v/f_lc>r_lc  %s\n", spacing.c_str());
  print_errors(outcome);
  std::printf("time         %.1f s, %.1f times real time\n", summary.wall_seconds,
              summary.data_seconds / std::max(summary.wall_seconds, 1e-9));
  for (const support::GoalResult& goal : summary.goals)
    std::printf("goal         %s %.4g: %.4g, %s\n", goal.name.c_str(), goal.bound, goal.value,
                goal.met ? "met" : "MISSED");
  if (!kept.empty()) std::printf("kept         what was there is now %s\n", printable(kept.native()).c_str());
  std::printf("report       %s\n", printable((folder.target() / "report.html").native()).c_str());
  if (verdict.failed) print_verdict(verdict, source);
}

int exit_code_of(const support::RunSummary& summary, bool data_failed, bool memory_full) {
  if (memory_full) return exit_output;
  if (data_failed) return exit_input;
  if (summary.interrupted) return exit_interrupted;
  const bool met = std::ranges::all_of(summary.goals, &support::GoalResult::met);
  return met ? exit_good : exit_goal_missed;
}

}  // namespace

int run(const MapArguments& arguments, SessionWorkers* workers) {
  MapperOptions options;
  configure(options, arguments.config, arguments.overrides);
  Datasets datasets = open_datasets(arguments, options);
  static_cast<void>(read_truths(arguments, datasets));  // what is wrong with them comes before the work
  const std::uint64_t max_memory = memory_bound(arguments.max_memory);
  const auto scans = std::make_shared<ScanCache>(options.scan_memory);
  SavedMaps saved = load_maps(arguments, max_memory, scans);
  const support::Interrupt interrupt;
  OutputFolder folder(arguments.out, arguments.overwrite);
  const std::string configuration = configuration_text(options);
  for (const auto& dataset : datasets) print_notes("note:", dataset->info().notes);

  const auto start = std::chrono::steady_clock::now();
  support::Progress progress;
  support::StageTimes times;
  InputJournal input(folder.path() / inputs_name, configuration, saved.references);
  MapJournal journal(folder.path() / map_name, {.parameters = configuration, .scan_cache = scans});
  auto synced = start - std::chrono::seconds(1);
  // The map follows from its inputs, which are on the disk: a sync a second costs the back end little time.
  const auto update = [&](const SlamMap& map) {
    const auto now = std::chrono::steady_clock::now();
    if (now - synced < std::chrono::seconds(1)) return journal.append(map);
    journal.update(map);
    synced = now;
  };
  const MappingRun mapping_run{.options = options,
                               .threads = to_index(arguments.threads),
                               .stop = interrupt.token(),
                               .max_scans = to_index(arguments.max_scans),
                               .max_memory = max_memory,
                               .progress = progress,
                               .times = times,
                               .record =
                                   [&](std::span<const MapInput> inputs) {
                                     for (const MapInput& one : inputs) input.append(one);
                                     input.commit();
                                   },
                               .journal = update};
  if (workers != nullptr) workers->begin(datasets, arguments.data, mapping_run, folder.target());
  MappingResult mapping = map_or_say_what_is_left(datasets, std::move(saved.maps), mapping_run, folder, input);
  support::return_free_memory();  // the back end's
  std::vector<std::optional<Trajectory>> truths(datasets.size());
  try {
    truths = read_truths(arguments, datasets);
  } catch (const IoError& error) {  // they were there when the work began: no reason to lose it
    mapping.notes.push_back(std::string("errors are left out, since the ground truth is gone: ") + error.what());
  }
  for (std::size_t i = 0; i < mapping.sessions.size(); ++i) {
    SessionRun& session = mapping.sessions[i];
    session.truth = std::move(truths[i]);
    if (workers != nullptr) workers->complete(i, session);
    print_notes("warning:", datasets[i]->info().warnings);
    print_notes("note:", session.notes);
    for (const std::string& warning : datasets[i]->info().warnings) session.notes.push_back(warning);
    const std::string& frame = datasets[i]->info().truth_frame;
    mapping.truths_share_frame &= !frame.empty() && frame == datasets[0]->info().truth_frame;
  }
  print_notes("warning:", mapping.notes);
  if (mapping.failure) std::fprintf(stderr, "error: %s\n", printable(mapping.failure->what(), true).c_str());
  if (mapping.memory_full)
    print_memory_error(max_memory, memory_remedy(mapping.map->keyframes.empty(), folder.target()));
  if (mapping.map->keyframes.empty()) {
    input.remove();
    journal.remove();
    if (mapping.memory_full) return exit_output;
    if (!mapping.failure && interrupt.requested()) {
      std::fprintf(stderr, "interrupted before the first keyframe: there is nothing to save\n");
      return exit_interrupted;
    }
    throw_without_keyframes(mapping, arguments);
  }

  progress.update({.stage = "writing"});
  progress.finish();
  // The map first: it is on the disk and has its name before anything else can fail.
  fs::path kept;
  {
    const auto measurement = times.measure("save");
    journal.finish(*mapping.map);
    input.remove();
    kept = folder.commit();
  }
  if (workers != nullptr && !mapping.interrupted) workers->map_saved();
  const bool memory_full = mapping.memory_full;
  const bool data_failed = mapping.failure.has_value() || has_empty_session(mapping, arguments);
  RunOutcome outcome = conclude(std::move(mapping), title(datasets), options);
  auto report = gather_report(*outcome.mapping.map, options.map_voxel, arguments.threads > 1);
  {
    const auto measurement = times.measure("write");
    write_results(folder, outcome, options);
    folder.file("config.toml", [&](const FileTarget& target) { write_text(target, configuration); });
  }
  outcome.summary.stages = times.rows();
  outcome.summary.wall_seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  outcome.summary.peak_memory = support::peak_memory();
  folder.file("summary.json", [&](const FileTarget& target) { support::write_summary(target, outcome.summary); });
  write_run_report(folder, outcome, report.get());
  print_outcome(outcome, folder, kept, options.odometry_source);

  return folder.exit_code(exit_code_of(outcome.summary, data_failed, memory_full));
}

}  // namespace chainslam::mapper
