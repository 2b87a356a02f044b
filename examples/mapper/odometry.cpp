#include <algorithm>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "chainslam/core/error.hpp"
#include "chainslam/io/atomic_file.hpp"
#include "console.hpp"
#include "datasets/odometry_recording.hpp"
#include "exit_code.hpp"
#include "map_file.hpp"
#include "options.hpp"
#include "output.hpp"
#include "results.hpp"
#include "session_recorder.hpp"
#include "simulated_dataset.hpp"
#include "support/interrupt.hpp"
#include "support/progress.hpp"
#include "support/summary.hpp"
#include "trajectory_file.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

namespace {

namespace fs = std::filesystem;

std::unique_ptr<datasets::Dataset> open_data(const OdometryArguments& arguments, const MapperOptions& options) {
  auto dataset = open_simulation(arguments.data.string());
  if (!dataset) dataset = datasets::open_dataset(arguments.data, options.dataset);
  if (dataset->info().has_odometry)
    throw_input_error(arguments.data.string(), "", "a keyframe set, which has odometry",
                      "map it: `chainslam map` takes the odometry that it has");
  return dataset;
}

/// What helps a run that needed more memory than it may have.
std::string memory_remedy(bool at_once) {
  return at_once ? "allow more: the limit does not suffice for one keyframe"
                 : "the results so far are recorded: map these, or allow more";
}

/// The goals that odometry alone can meet.
Goals goals_of_odometry(const Goals& goals) {
  return {.max_lost_share = goals.max_lost_share, .max_map_restarts = goals.max_map_restarts};
}

void print_outcome(const RunOutcome& outcome, const support::StageTimes& times, const fs::path& set,
                   const fs::path& kept, OdometrySourceKind source) {
  const support::RunSummary& summary = outcome.summary;
  const support::Verdict verdict = support::verdict_of(summary);
  print_verdict(verdict, source);
  std::printf("scans        %d (%d lost, %d degenerate)\n", summary.scans, summary.lost_frames,
              summary.degenerate_frames);
  print_imu(summary);
  std::printf("keyframes    %d over %.1f m\n", summary.keyframes, summary.path_length);
  if (outcome.odometry_errors)
    std::printf("error        %.3f m rmse (against the truth, rigidly aligned)\n",
                outcome.odometry_errors->translation.rmse);
  for (const support::StageTime& row : times.rows())
    if (row.stage == "odometry")
      std::printf("time         %.1f ms per scan (median), %.1f ms (99 %%)\n", 1e3 * row.p50, 1e3 * row.p99);
  if (!kept.empty()) std::printf("kept         what was there is now %s\n", printable(kept.native()).c_str());
  std::printf("recorded     %s\n", printable(set.native()).c_str());
}

}  // namespace

int run(const OdometryArguments& arguments) {
  const auto start = std::chrono::steady_clock::now();
  MapperOptions options;
  configure(options, arguments.config, arguments.overrides);
  const auto dataset = open_data(arguments, options);
  std::optional<Trajectory> truth =
      arguments.truth.empty() ? dataset->truth() : std::optional(read_trajectory(arguments.truth).trajectory);
  const support::Interrupt interrupt;
  OutputFolder folder(arguments.out, arguments.overwrite);
  folder.drop_all_unless_committed();  // scans without their tables are of no use
  print_notes("note:", dataset->info().notes);

  support::Progress progress;
  support::StageTimes times;
  const MappingRun mapping_run{.options = options,
                               .threads = to_index(arguments.threads),
                               .stop = interrupt.token(),
                               .max_scans = to_index(arguments.max_scans),
                               .max_memory = memory_bound(arguments.max_memory),
                               .progress = progress,
                               .times = times};
  datasets::OdometryRecording recording(folder.path());
  MappingResult result = record_odometry(*dataset, mapping_run, recording);
  SessionRun& session = result.sessions[0];
  print_notes("warning:", dataset->info().warnings);
  print_notes("note:", session.notes);
  for (const std::string& warning : dataset->info().warnings) session.notes.push_back(warning);
  const bool failed = session.failure.has_value();
  if (failed) std::fprintf(stderr, "error: %s\n", printable(session.failure->what(), true).c_str());
  const bool memory_full = result.memory_full;
  if (memory_full) print_memory_error(mapping_run.max_memory, memory_remedy(result.map->keyframes.empty()));
  if (memory_full && result.map->keyframes.empty()) return exit_output;
  if (result.map->keyframes.empty() && !result.interrupted)
    throw_input_error(arguments.data.string(), "",
                      std::to_string(session.scans) + " scans, none of which could be used",
                      "run `chainslam inspect` on it; compare odometry.min_range and max_range with the scans' ranges");
  recording.finish(recording_info(dataset->info(), session, options), truth);
  AtomicFile configuration(folder.path() / "config.toml");
  configuration.write(configuration_text(options));
  configuration.commit();
  const fs::path kept = folder.commit();

  session.truth = std::move(truth);
  const bool interrupted = result.interrupted && !failed;
  options.goals = goals_of_odometry(options.goals);
  RunOutcome outcome = conclude(std::move(result), arguments.data.string(), options);
  for (const std::string& note : dataset->info().notes) outcome.summary.notes.push_back(note);
  outcome.summary.stages = times.rows();
  outcome.summary.wall_seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  outcome.summary.peak_memory = support::peak_memory();
  folder.file("summary.json", [&](const FileTarget& target) { support::write_summary(target, outcome.summary); });
  print_outcome(outcome, times, folder.target(), kept, options.odometry_source);
  if (memory_full) return exit_output;
  if (failed) return exit_input;
  if (interrupted) return exit_interrupted;
  const bool met = std::ranges::all_of(outcome.summary.goals, &support::GoalResult::met);
  return folder.exit_code(met ? exit_good : exit_goal_missed);
}

}  // namespace chainslam::mapper
