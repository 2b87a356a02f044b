#include <algorithm>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/core/printable.hpp"
#include "chainslam/io/file_system.hpp"
#include "chainslam/io/map_archive.hpp"
#include "console.hpp"
#include "datasets/dataset.hpp"
#include "exit_code.hpp"
#include "mapping.hpp"
#include "options.hpp"
#include "output_folder.hpp"
#include "results.hpp"
#include "simulated_dataset.hpp"
#include "support/interrupt.hpp"
#include "support/progress.hpp"
#include "support/summary.hpp"
#include "trajectory_file.hpp"
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
    throw std::invalid_argument("--truth names " + std::to_string(arguments.truths.size()) + " files for " +
                                std::to_string(datasets.size()) +
                                " data sets\n  found: too few or too many\n  do: give one for each, in their order");
  std::vector<std::optional<Trajectory>> truths;
  for (std::size_t i = 0; i < datasets.size(); ++i)
    truths.push_back(arguments.truths.empty() ? datasets[i]->truth()
                                              : std::optional(read_trajectory(arguments.truths[i]).trajectory));
  return truths;
}

/// Saved maps, given by their file or by the folder of results that holds it.
std::vector<SlamMap> load_maps(const MapArguments& arguments) {
  std::vector<SlamMap> maps;
  for (const fs::path& path : arguments.maps)
    maps.push_back(load_map(fs::is_directory(path) ? path / "map.cslam" : path).map);
  return maps;
}

std::string title(const Datasets& datasets) {
  std::string names;
  for (const auto& dataset : datasets) {
    const datasets::DatasetInfo& info = dataset->info();
    names += (names.empty() ? "" : ", ") + info.name + (info.source.empty() ? "" : " (" + info.source + ")");
  }
  return names;
}

void write_text(const fs::path& path, const std::string& text) {
  AtomicFile file(path);
  file.write(text);
  file.commit();
}

/// What came to nothing: nothing to map, or nothing that could be used.
void require_keyframes(const MappingResult& mapping, const MapArguments& arguments) {
  for (std::size_t i = 0; i < mapping.sessions.size(); ++i) {
    const SessionRun& session = mapping.sessions[i];
    if (mapping.interrupted || !session.odometry.empty()) continue;
    throw_input_error(arguments.data[i].string(), "",
                      std::to_string(session.scans) + " scans, none of which could be used",
                      "run `chainslam inspect` on it; compare odometry.min_range and max_range with the scans' ranges");
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

}  // namespace

int run(const MapArguments& arguments) {
  MapperOptions options;
  configure(options, arguments.config, arguments.overrides);
  const Datasets datasets = open_datasets(arguments, options);
  std::vector<std::optional<Trajectory>> truths = read_truths(arguments, datasets);
  const std::vector<SlamMap> maps = load_maps(arguments);
  OutputFolder folder(arguments.out, arguments.overwrite);
  folder.keep_unfinished("map.cslam.partial");
  const std::string configuration = configuration_text(options);
  for (const auto& dataset : datasets) print_notes("note:", dataset->info().notes);

  const auto start = std::chrono::steady_clock::now();
  const support::Interrupt interrupt;
  support::Progress progress;
  support::StageTimes times;
  MapJournal journal(folder.path() / "map.cslam", {.parameters = configuration});
  const MappingRun mapping_run{.options = options,
                               .threads = to_index(arguments.threads),
                               .stop = interrupt.token(),
                               .max_scans = to_index(arguments.max_scans),
                               .progress = progress,
                               .times = times,
                               .journal = [&](const SlamMap& map) { journal.update(map); }};
  MappingResult mapping = run_mapping(datasets, maps, mapping_run);
  for (std::size_t i = 0; i < mapping.sessions.size(); ++i) {
    SessionRun& session = mapping.sessions[i];
    session.truth = std::move(truths[i]);
    print_notes("warning:", datasets[i]->info().warnings);
    print_notes("note:", session.notes);
    for (const std::string& warning : datasets[i]->info().warnings) session.notes.push_back(warning);
    const std::string& frame = datasets[i]->info().truth_frame;
    mapping.truths_share_frame &= !frame.empty() && frame == datasets[0]->info().truth_frame;
  }
  print_notes("warning:", mapping.notes);
  require_keyframes(mapping, arguments);

  RunOutcome outcome = conclude(std::move(mapping), title(datasets), options);
  {
    const auto measurement = times.measure("write");
    write_results(folder.path(), outcome, options);
    write_text(folder.path() / "config.toml", configuration);
    journal.finish(*outcome.mapping.map);
  }
  outcome.summary.stages = times.rows();
  outcome.summary.wall_seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  outcome.summary.peak_memory = support::peak_memory();
  write_run_report(folder.path(), outcome, options.map_voxel);
  support::write_summary(folder.path() / "summary.json", outcome.summary);
  const fs::path kept = folder.commit();
  print_outcome(outcome, folder, kept, options.odometry_source);

  if (outcome.summary.interrupted) return exit_interrupted;
  for (const support::GoalResult& goal : outcome.summary.goals)
    if (!goal.met) return exit_goal_missed;
  return exit_good;
}

}  // namespace chainslam::mapper
