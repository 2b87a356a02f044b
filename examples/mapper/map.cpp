#include <chrono>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/core/thread_pool.hpp"
#include "chainslam/io/file_system.hpp"
#include "datasets/dataset.hpp"
#include "exit_code.hpp"
#include "mapping.hpp"
#include "options.hpp"
#include "output_folder.hpp"
#include "results.hpp"
#include "support/interrupt.hpp"
#include "support/progress.hpp"
#include "support/summary.hpp"
#include "trajectory_file.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

namespace {

namespace fs = std::filesystem;

struct MapArguments {
  fs::path data, out, config, truth;
  std::vector<std::string> overrides;
  bool overwrite = false;
  int threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  int max_scans = 0;
};

std::optional<Trajectory> truth_of(const datasets::Dataset& dataset, const fs::path& given) {
  if (!given.empty()) return read_trajectory(given).trajectory;
  return dataset.truth();
}

/// The configuration as it was in force, so that the run can be repeated.
void write_configuration(const fs::path& path, MapperOptions options) {
  AtomicFile file(path);
  file.write(make_configuration(options).print());
  file.commit();
}

void print_notes(const char* mark, const std::vector<std::string>& notes) {
  for (const std::string& note : notes) std::fprintf(stderr, "%s %s\n", mark, note.c_str());
}

void print_outcome(const RunOutcome& outcome, const OutputFolder& folder, const fs::path& kept) {
  const support::RunSummary& summary = outcome.summary;
  std::printf("scans        %d (%d lost, %d degenerate)\n", summary.scans, summary.lost_frames,
              summary.degenerate_frames);
  std::printf("keyframes    %d over %.1f m\n", summary.keyframes, summary.path_length);
  std::printf("closures     %d accepted\n", summary.direct_closures);
  for (const auto& [reason, count] : summary.refusals)
    std::printf("             %d refused: %s\n", count, reason.c_str());
  if (outcome.optimised_errors)
    std::printf("error        %.3f m rmse, odometry alone %.3f m (against the truth, rigidly aligned)\n",
                outcome.optimised_errors->ape.translation.rmse, outcome.odometry_errors->ape.translation.rmse);
  std::printf("time         %.1f s, %.1f times real time\n", summary.wall_seconds,
              summary.data_seconds / std::max(summary.wall_seconds, 1e-9));
  for (const support::GoalResult& goal : summary.goals)
    std::printf("goal         %s %.4g: %.4g, %s\n", goal.name.c_str(), goal.bound, goal.value,
                goal.met ? "met" : "MISSED");
  if (!kept.empty()) std::printf("kept         what was there is now %s\n", kept.c_str());
  std::printf("report       %s\n", (folder.target() / "report.html").c_str());
}

int run(const MapArguments& arguments) {
  MapperOptions options;
  configure(options, arguments.config, arguments.overrides);
  const auto dataset = datasets::open_dataset(arguments.data, options.dataset);
  const std::optional<Trajectory> truth = truth_of(*dataset, arguments.truth);
  OutputFolder folder(arguments.out, arguments.overwrite);
  print_notes("note:", dataset->info().notes);

  const auto start = std::chrono::steady_clock::now();
  const support::Interrupt interrupt;
  support::Progress progress;
  support::StageTimes times;
  const ThreadPool threads(to_index(arguments.threads));
  const MappingRun mapping_run{options, threads, interrupt.token(), to_index(arguments.max_scans), progress, times};
  MappingResult mapping = run_mapping(*dataset, mapping_run);
  print_notes("warning:", dataset->info().oddities);
  print_notes("note:", mapping.notes);
  if (mapping.map->keyframes.empty())
    throw_input_error(arguments.data.string(), "",
                      std::to_string(mapping.scans) + " scans, none of which could be used",
                      "run `chainslam inspect` on it; compare odometry.min_range and max_range with the scans' ranges");
  for (const std::string& oddity : dataset->info().oddities) mapping.notes.push_back(oddity);

  RunOutcome outcome = conclude(std::move(mapping), truth, dataset->info().name, options);
  {
    const auto measurement = times.measure("write");
    write_results(folder.path(), outcome, options);
    write_configuration(folder.path() / "config.toml", options);
  }
  outcome.summary.stages = times.rows();
  outcome.summary.wall_seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  outcome.summary.peak_memory = support::peak_memory();
  write_run_report(folder.path(), outcome, options.map_voxel);
  support::write_summary(folder.path() / "summary.json", outcome.summary);
  const fs::path kept = folder.commit();
  print_outcome(outcome, folder, kept);

  if (outcome.summary.interrupted) return exit_interrupted;
  for (const support::GoalResult& goal : outcome.summary.goals)
    if (!goal.met) return exit_goal_missed;
  return exit_good;
}

}  // namespace

CLI::App* add_map(CLI::App& program, int& exit_code) {
  const auto arguments = std::make_shared<MapArguments>();
  CLI::App* verb = program.add_subcommand("map", "map a data set: odometry, loop closures, pose graph, report");
  verb->footer(
      "DIR gets report.html, map.ply, trajectory.tum and .kitti.txt, odometry.tum, graph.g2o, keyframes.csv,\n"
      "closures.csv, config.toml, summary.json and map.png. Ctrl-C finishes the scan at hand and saves what there is;\n"
      "a second Ctrl-C stops at once. `chainslam config --print` shows everything that can be configured.");
  verb->add_option("DATA", arguments->data, "folder of a data set (see chainslam inspect)")
      ->required()
      ->option_text(" ");
  verb->add_option("--out", arguments->out, "folder to write")->required()->option_text("DIR");
  verb->add_flag("--overwrite", arguments->overwrite, "if DIR holds something, keep that as DIR~1");
  verb->add_option("--config", arguments->config, "configuration file (TOML)")->option_text("FILE");
  verb->add_option("--set", arguments->overrides, "override a key of it, may be given again")
      ->option_text("KEY=VALUE")
      ->allow_extra_args(false);
  verb->add_option("--truth", arguments->truth, "true trajectory, to state errors; default: the data set's own")
      ->option_text("FILE");
  verb->add_option("--max-scans", arguments->max_scans, "stop after so many scans")
      ->check(CLI::NonNegativeNumber)
      ->option_text("N");
  verb->add_option("--threads", arguments->threads, "default: all cores; changes the time, not the result")
      ->check(CLI::Range(1, 1024))
      ->option_text("N");
  verb->callback([arguments, &exit_code] { exit_code = run(*arguments); });
  return verb;
}

}  // namespace chainslam::mapper
