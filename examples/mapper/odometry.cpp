#include <algorithm>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "chainslam/cloud/quantize.hpp"
#include "chainslam/cloud/voxel_grid.hpp"
#include "chainslam/core/error.hpp"
#include "chainslam/io/atomic_file.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "console.hpp"
#include "datasets/odometry_recording.hpp"
#include "exit_code.hpp"
#include "map_file.hpp"
#include "options.hpp"
#include "output.hpp"
#include "results.hpp"
#include "session_front_end.hpp"
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

/// The points that a map keeps of a scan (see `KeyframeSelector`), with their intensities, which a map does not keep.
PointCloud<float> recorded_scan(const PointCloud<float>& scan, const KeyframeOptions& options) {
  const PointCloud<float> kept = options.scan_voxel > 0 ? voxel_downsample(scan, options.scan_voxel) : scan;
  return options.scan_step > 0 ? quantized_with_intensities(kept, options.scan_step) : kept;
}

/// Keyframes as the options pick them, with their whole scans.
KeyframeSelector whole_keyframes(KeyframeOptions options) {
  options.scan_voxel = options.scan_step = 0;
  return KeyframeSelector(options);
}

/// Runs odometry on a data set; frames and what is kept of them go to the recording, all but scans to a map.
class Recorder {
 public:
  Recorder(datasets::Dataset& dataset, const MappingRun& run, datasets::OdometryRecording& recording)
      : dataset_(dataset), run_(run), recording_(recording), select_(whole_keyframes(run.options.keyframes)) {
    state_.stage = "odometry of " + dataset.info().name;
    state_.total = expected_scans(dataset.info(), run.max_scans);
  }

  [[nodiscard]] MappingResult record() {
    const ThreadPool threads(run_.threads);
    MappingResult result;
    result.sessions.push_back(SessionFrontEnd(dataset_, run_, threads,
                                              {.fix = [&](const GnssFix& fix) { recording_.add(fix); },
                                               .frame = [&](const Frame& frame) { add(frame); },
                                               .scan = [&](const SessionRun& so_far) { show(so_far); }})
                                  .run());
    run_.progress.finish();
    result.sessions[0].id = session;
    map_.sessions.push_back({.id = session,
                             .name = result.sessions[0].name,
                             .first_keyframe = 0,
                             .keyframes = to_index(map_.keyframes.size()),
                             .frame = session,
                             .prior = {}});
    result.map = std::make_shared<const SlamMap>(std::move(map_));
    result.memory_full = result.sessions[0].memory_full;
    result.interrupted = run_.stop.stop_requested() || result.memory_full;
    return result;
  }

 private:
  static constexpr SessionId session{0};

  void show(const SessionRun& so_far) {
    state_.done = so_far.scans;
    state_.keyframes = to_index(map_.keyframes.size());
    run_.progress.update(state_);
  }

  void add(const Frame& frame) {
    FrameRecord record = record_of(frame);
    record.session = session;
    std::optional<Keyframe> keyframe = select_(frame);
    if (keyframe)
      keyframe->cloud =
          std::make_shared<const PointCloud<float>>(recorded_scan(*keyframe->cloud.load(), run_.options.keyframes));
    {
      const auto measurement = run_.times.measure("write");
      recording_.add(record, keyframe);
    }
    map_.frames.push_back(record);
    state_.data_seconds = to_seconds(frame.time - map_.frames.front().time);
    if (!keyframe) return;
    keyframe->id = KeyframeId{to_index(map_.keyframes.size())};
    keyframe->session = session;
    keyframe->T_map_body = keyframe->T_odom_body;
    keyframe->cloud.reset();  // it is in the recording
    map_.keyframes.push_back(std::move(*keyframe));
  }

  datasets::Dataset& dataset_;
  const MappingRun& run_;
  datasets::OdometryRecording& recording_;
  KeyframeSelector select_;
  SlamMap map_;
  support::ProgressState state_;
};

datasets::RecordingInfo description(const datasets::DatasetInfo& dataset, const SessionRun& session,
                                    const MapperOptions& options) {
  return {.session = session.name,
          .odometry = name_of(options.odometry_source),
          .source = dataset.source,
          .truth_frame = dataset.truth_frame,
          .scans = session.scans,
          .keyframes = options.keyframes,
          .notes = session.notes};
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
  MappingResult result = Recorder(*dataset, mapping_run, recording).record();
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
  recording.finish(description(dataset->info(), session, options), truth);
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
