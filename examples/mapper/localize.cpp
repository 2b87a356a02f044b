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
#include "chainslam/io/trajectory_file.hpp"
#include "chainslam/slam/localizer.hpp"
#include "chainslam/trajectory/association.hpp"
#include "chainslam/trajectory/pose_errors.hpp"
#include "console.hpp"
#include "datasets/dataset.hpp"
#include "exit_code.hpp"
#include "localization_files.hpp"
#include "map_file.hpp"
#include "options.hpp"
#include "output.hpp"
#include "results.hpp"
#include "session_front_end.hpp"
#include "simulated_dataset.hpp"
#include "support/interrupt.hpp"
#include "support/progress.hpp"
#include "trajectory_file.hpp"
#include "unfinished_run.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

namespace {

namespace fs = std::filesystem;

using MapLocalizer = Localizer<LoopCloser<ProximityCandidates, ClosureRegistration, ClosureNoise>>;

SlamMap load_localization_map(const LocalizeArguments& arguments) {
  const fs::path path = fs::is_directory(arguments.map) ? arguments.map / map_name : arguments.map;
  SlamMap map = open_map(path, {.max_memory = memory_bound(arguments.max_memory)}).map;
  if (std::ranges::none_of(map.keyframes, [](const Keyframe& one) { return one.cloud.size() > 0; }))
    throw_input_error(path.string(), "", "a map without scans", "make a map of data with scans: `chainslam map`");
  return map;
}

/// Runs the front end on a data set and localizes its frames in a map.
class DriveLocalizer {
 public:
  DriveLocalizer(datasets::Dataset& dataset, const MappingRun& run, const ThreadPool& threads, MapLocalizer& localizer)
      : dataset_(dataset), run_(run), threads_(threads), localizer_(localizer) {
    state_.stage = "localizing " + dataset.info().name;
    state_.total = expected_scans(dataset.info(), run.max_scans);
  }

  [[nodiscard]] SessionRun run(LocalizationRun& result) {
    SessionRun session = SessionFrontEnd(dataset_, run_, threads_,
                                         {.fix = [](const GnssFix&) {},
                                          .frame = [&](const Frame& frame) { add(frame, result); },
                                          .scan = [&](const SessionRun& so_far) { show(so_far); }})
                             .run();
    run_.progress.finish();
    return session;
  }

 private:
  void add(const Frame& frame, LocalizationRun& result) {
    const auto measurement = run_.times.measure("localization");
    result.frames.push_back(localizer_.process(frame, threads_));
    const double time = to_seconds(frame.time - result.frames.front().time);
    if (result.frames.back().T_map_body && !result.first_fix) result.first_fix = time;
    state_.data_seconds = result.data_seconds = time;
  }
  void show(const SessionRun& so_far) {
    state_.done = so_far.scans;
    run_.progress.update(state_);
  }

  datasets::Dataset& dataset_;
  const MappingRun& run_;
  const ThreadPool& threads_;
  MapLocalizer& localizer_;
  support::ProgressState state_;
};

/// Of the poses that were tracked, in the frame in which most of them are, aligned rigidly with the truth.
std::optional<AbsolutePoseErrors> errors_against(const Trajectory& truth, const LocalizationRun& run) {
  const auto matched = match_interpolated(truth, localized_poses(run.frames, true), seconds(1)).trajectories;
  AbsolutePoseErrors errors = ape(matched.reference, matched.estimate, {.align = Alignment::se3});
  if (errors.status != EvaluationStatus::evaluated) return std::nullopt;
  return errors;
}

void print_localization(const LocalizationRun& run, const OutputFolder& folder, const fs::path& kept) {
  const LocalizerCounts& counts = run.counts;
  const Index after = counts.tracked + counts.uncertain + counts.lost;
  if (run.first_fix)
    std::printf("found        after %.1f s; %d start%s, lost %d time%s\n", *run.first_fix, counts.starts,
                counts.starts == 1 ? "" : "s", counts.losses, counts.losses == 1 ? "" : "s");
  else
    std::printf("not found    in %.1f s of data: no place of the map was recognized and confirmed\n", run.data_seconds);
  if (after > 0)
    std::printf("frames       %d since then: %.1f %% tracked, %.1f %% uncertain, %.1f %% lost\n", after,
                100.0 * counts.tracked / after, 100.0 * counts.uncertain / after, 100.0 * counts.lost / after);
  std::printf("scans        %d registered to the map, %d refused\n", counts.registrations - counts.refusals,
              counts.refusals);
  if (run.errors)
    std::printf("error        %.3f m rmse (tracked poses against the truth, rigidly aligned)\n",
                run.errors->translation.rmse);
  std::printf("time         %.1f s, %.1f times real time\n", run.wall_seconds,
              run.data_seconds / std::max(run.wall_seconds, 1e-9));
  if (!kept.empty()) std::printf("kept         what was there is now %s\n", printable(kept.native()).c_str());
  std::printf("poses        %s\n", printable((folder.target() / "localization.csv").native()).c_str());
}

}  // namespace

int run(const LocalizeArguments& arguments) {
  MapperOptions options;
  configure(options, arguments.config, arguments.overrides);
  auto dataset = open_simulation(arguments.data.string());
  if (!dataset) dataset = datasets::open_dataset(arguments.data, options.dataset);
  const std::optional<Trajectory> truth =
      arguments.truth.empty() ? dataset->truth() : std::optional(read_trajectory(arguments.truth).trajectory);
  const SlamMap map = load_localization_map(arguments);
  const support::Interrupt interrupt;
  OutputFolder folder(arguments.out, arguments.overwrite);
  print_notes("note:", dataset->info().notes);

  const auto start = std::chrono::steady_clock::now();
  support::Progress progress;
  support::StageTimes times;
  const MappingRun mapping_run{.options = options,
                               .threads = to_index(arguments.threads),
                               .stop = interrupt.token(),
                               .max_scans = to_index(arguments.max_scans),
                               .max_memory = memory_bound(arguments.max_memory),
                               .progress = progress,
                               .times = times};
  const BackEndParts& parts = options.back_end;
  const ThreadPool threads(mapping_run.threads);
  std::optional<MapLocalizer> localizer;
  {
    const auto measurement = times.measure("places");
    progress.update({.stage = "places of the map"});
    localizer.emplace(map, options.localizer,
                      LoopCloser(parts.closures, parts.candidates, parts.registration, parts.noise),
                      PlaceCandidates(options.localizer_places), threads);
  }
  LocalizationRun result;
  const SessionRun session = DriveLocalizer(*dataset, mapping_run, threads, *localizer).run(result);
  print_notes("warning:", dataset->info().warnings);
  print_notes("note:", session.notes);
  const bool memory_full = session.memory_full, failed = session.failure.has_value();
  if (failed) std::fprintf(stderr, "error: %s\n", printable(session.failure->what(), true).c_str());
  if (memory_full) print_memory_error(mapping_run.max_memory, "the poses so far are saved: allow more");
  result.interrupted = !failed && mapping_run.stop.stop_requested();
  if (result.frames.empty() && !result.interrupted && !memory_full)
    throw_input_error(arguments.data.string(), "",
                      std::to_string(session.scans) + " scans, none of which could be used",
                      "run `chainslam inspect` on it; compare odometry.min_range and max_range with the scans' ranges");
  result.counts = localizer->counts();
  if (truth) result.errors = errors_against(*truth, result);
  result.stages = times.rows();
  result.wall_seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  folder.file("localization.csv", [&](const FileTarget& target) { write_localizations(target, result.frames); });
  folder.file("localization.tum",
              [&](const FileTarget& target) { write_tum(target, localized_poses(result.frames, false)); });
  folder.file("config.toml", [&](const FileTarget& target) {
    AtomicFile file(target);
    file.write(configuration_text(options));
    file.commit();
  });
  folder.file("summary.json", [&](const FileTarget& target) { write_localization_summary(target, result); });
  const fs::path kept = folder.commit();
  print_localization(result, folder, kept);
  if (memory_full) return exit_output;
  if (failed) return exit_input;
  if (result.interrupted) return exit_interrupted;
  return folder.exit_code(result.first_fix ? exit_good : exit_goal_missed);
}

}  // namespace chainslam::mapper
