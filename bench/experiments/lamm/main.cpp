// LAMM on keyframe sets, with the same files and errors as `chainslam map` gives.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <string>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/core/thread_pool.hpp"
#include "chainslam/io/atomic_file.hpp"
#include "chainslam/io/map_archive.hpp"
#include "console.hpp"
#include "exit_code.hpp"
#include "keyframe_sets.hpp"
#include "lamm.hpp"
#include "merged_map.hpp"
#include "options.hpp"
#include "output.hpp"
#include "results.hpp"
#include "support/progress.hpp"
#include "support/statistics.hpp"
#include "support/summary.hpp"

namespace {

namespace fs = std::filesystem;
using namespace chainslam;
using Clock = std::chrono::steady_clock;

struct Arguments {
  std::vector<fs::path> sets;
  fs::path out;
  bool overwrite = false;
  bool as_released = false;
  int threads = ThreadPool::hardware_threads();
  lamm::KeyCloudOptions clouds;
};

void add_options(CLI::App& app, Arguments& arguments) {
  app.footer(
      "DIR gets what `chainslam map` writes but for its report: map.cslam, trajectory.tum and .kitti.txt, "
      "odometry.tum,\n"
      "keyframes.csv, frames.csv, closures.csv, graph.g2o, map.ply and summary.json, of several sets a trajectory "
      "each;\n"
      "and lamm.json, with counts and times of LAMM alone. It appears whole or not at all.\n"
      "Exit codes: 0 good, 2 usage, 3 input unusable, 4 output or disk, 70 internal error.");
  app.add_option("SET", arguments.sets, "keyframe sets, as `chainslam odometry` writes them")
      ->required()
      ->option_text("...");
  app.add_option("--out", arguments.out, "folder to write")->required()->option_text("DIR");
  app.add_flag("--overwrite", arguments.overwrite, "if DIR holds something, keep that as DIR~1");
  app.add_flag("--as-released", arguments.as_released,
               "do what the released program does, faults included; default: the method as it was designed");
  app.add_option("--cloud-scans", arguments.clouds.max_scans, "keyframes of a key cloud, at most")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  app.add_option("--cloud-length", arguments.clouds.max_length, "metres from its first keyframe to its last, at most")
      ->check(CLI::Range(0.0, 1e4))
      ->capture_default_str();
  app.add_option("--cloud-spacing", arguments.clouds.spacing, "metres from one key cloud to the next, at least")
      ->check(CLI::Range(0.0, 1e4))
      ->capture_default_str();
  app.add_option("--threads", arguments.threads, "default: all cores; changes the time, not the result")
      ->check(CLI::Range(1, 1024))
      ->option_text("N");
}

lamm::Options options_of(const Arguments& arguments) {
  lamm::Options options = arguments.as_released ? lamm::as_released() : lamm::Options{};
  options.clouds = arguments.clouds;
  return options;
}

void write_text(const FileTarget& target, const std::string& text) {
  AtomicFile file(target);
  file.write(text);
  file.commit();
}

void print_outcome(const mapper::RunOutcome& outcome, const lamm::Result& result, const fs::path& out) {
  const auto kept = std::ranges::count_if(result.loops, &lamm::Loop::kept);
  const support::RunSummary& summary = outcome.summary;
  std::printf("key clouds   %d, %d keypoints, %d triangles\n", result.counts.key_clouds, result.counts.keypoints,
              result.counts.triangles);
  std::printf("loops        %zu verified, %td kept: %d within sessions, %d between\n", result.loops.size(), kept,
              summary.direct_closures, summary.merge_closures);
  std::printf("sessions     %zu, %d joined to others\n", summary.sessions.size(), summary.merges);
  mapper::print_errors(outcome);
  std::printf("time         %.1f s\n", summary.wall_seconds);
  std::printf("written      %s\n", printable(out.native()).c_str());
}

int run(const Arguments& arguments) {
  mapper::require_free(arguments.out, arguments.overwrite);
  const Clock::time_point begin = Clock::now();
  const lamm::Options options = options_of(arguments);
  std::vector<lamm::KeyframeSet> sets;
  std::vector<lamm::Drive> drives;
  std::string title;
  support::StageTimes times;
  for (const fs::path& path : arguments.sets) {
    const auto measurement = times.measure("read");
    sets.push_back(lamm::read_keyframe_set(path));
    drives.push_back(sets.back().drive);
    title += (title.empty() ? "" : ", ") + sets.back().title;
  }
  const ThreadPool threads(to_index(arguments.threads));
  const lamm::Result result = lamm::merge(drives, options, threads);
  times.add("describe", result.counts.describe_seconds);
  times.add("search", result.counts.search_seconds);
  times.add("optimize", result.counts.optimize_seconds);
  const mapper::MapperOptions settings;
  mapper::RunOutcome outcome =
      mapper::conclude(lamm::mapping_result(std::move(sets), result, options.graph), title, settings);

  mapper::OutputFolder folder(arguments.out, arguments.overwrite);
  folder.drop_all_unless_committed();
  {
    const auto measurement = times.measure("write");
    folder.file("map.cslam", [&](const FileTarget& target) { save_map(target.path, *outcome.mapping.map); });
    mapper::write_results(folder, outcome, settings);
  }
  outcome.summary.stages = times.rows();
  outcome.summary.wall_seconds = std::chrono::duration<double>(Clock::now() - begin).count();
  outcome.summary.peak_memory = support::peak_memory();
  folder.file("lamm.json", [&](const FileTarget& target) {
    write_text(target, lamm::lamm_json(result, options, arguments.as_released));
  });
  folder.file("summary.json", [&](const FileTarget& target) { support::write_summary(target, outcome.summary); });
  const int code = folder.exit_code(mapper::exit_good);
  if (code != mapper::exit_good) return code;
  folder.commit();
  print_outcome(outcome, result, folder.target());
  return code;
}

int report(const std::string& message, int code) {
  std::fprintf(stderr, "error: %s\n", printable(message, true).c_str());
  return code;
}

}  // namespace

int main(int argc, char** argv) {
  std::signal(SIGXFSZ, SIG_IGN);  // a limit on file sizes then is an error like any other
  std::signal(SIGPIPE, SIG_IGN);
  CLI::App app("LAMM: merges sessions off line, as a baseline for the tables");
  Arguments arguments;
  add_options(app, arguments);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? mapper::exit_good : mapper::exit_usage;
  }
  try {
    return run(arguments);
  } catch (const IoError& error) {
    return report(error.what(), error.kind() == IoError::Kind::input ? mapper::exit_input : mapper::exit_output);
  } catch (const std::exception& error) {
    return report(error.what(), mapper::exit_internal);
  }
}
