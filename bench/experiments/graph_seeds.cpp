// The back end on odometry and closures that are drawn from what a run with scans has measured, many times: see
// README.md beside this file.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <iterator>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/io/atomic_file.hpp"
#include "chainslam/io/map_archive.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "datasets/dataset.hpp"
#include "graph/drawn_world.hpp"
#include "graph/graph_errors.hpp"
#include "mapper/options.hpp"
#include "support/interrupt.hpp"
#include "support/progress.hpp"
#include "support/statistics.hpp"
#include "table_file.hpp"

namespace chainslam::experiments {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

struct Arguments {
  fs::path map, out;
  std::vector<fs::path> sets;
  std::vector<fs::path> more;  ///< recordings of the same world that the map does not have
  std::vector<std::string> overrides;
  int seeds = 20;
  int growth = 0;  ///< sessions of one world, timed
  TownOptions town;
};

/// A recording, wherever the truth is known.
MeasuredDrive read_drive(const fs::path& set) {
  const auto dataset = datasets::open_dataset(set, {});
  const std::optional<Trajectory> truth = dataset->truth();
  if (!truth) throw_input_error(set.string(), "", "no truth", "give recordings of data with truth");
  MeasuredDrive drive;
  Leg leg;
  bool known = false;  // whether the frame before has a true pose: velocity is gained since that frame
  const auto take_fixes = [&] { std::ranges::move(dataset->take_fixes(), std::back_inserter(leg.fixes)); };
  while (const auto frame = dataset->next_frame()) {
    take_fixes();
    const auto pose = pose_at(*truth, frame->time, seconds(2.0));
    const bool follows = std::exchange(known, pose.has_value());
    if (!pose) continue;
    leg.frames.push_back({frame->time, *pose, follows ? record_of(*frame).delta_velocity : std::nullopt});
    if (frame->cloud.empty()) continue;
    drive.truth.times.push_back(frame->time);
    drive.truth.poses.push_back(*pose);
    drive.odometry.times.push_back(frame->time);
    drive.odometry.poses.push_back(frame->T_odom_body);
    drive.legs.push_back(std::exchange(leg, {}));
  }
  take_fixes();
  drive.last_fixes = std::move(leg.fixes);
  if (drive.truth.size() < 3)
    throw_input_error(set.string(), "", std::to_string(drive.truth.size()) + " keyframes with truth",
                      "give longer ones");
  return drive;
}

/// Root mean square over all steps of a few of their components.
double root_mean_square(const std::vector<std::vector<Vector6d>>& errors, int first, int count) {
  double sum = 0, steps = 0;
  for (const auto& session : errors)
    for (const Vector6d& error : session) sum += error.segment(first, count).squaredNorm(), ++steps;
  return std::sqrt(sum / steps);
}

/// Correlation of an error with that of the next step, over all components of translation or rotation.
double next_step_correlation(const std::vector<std::vector<Vector6d>>& errors, int first) {
  double product = 0, square = 0;
  for (const auto& session : errors)
    for (std::size_t i = 1; i < session.size(); ++i) {
      product += session[i].segment(first, 3).dot(session[i - 1].segment(first, 3));
      square += session[i].segment(first, 3).squaredNorm();
    }
  return product / square;
}

json statistics_of(const std::vector<Attempt>& attempts) {
  Index converged = 0, wrong = 0;
  double translation = 0, rotation = 0;
  for (const Attempt& attempt : attempts) {
    if (!attempt.converged) continue;
    ++converged;
    if (is_false(attempt.error)) {
      ++wrong;
      continue;
    }
    translation += attempt.error.head<3>().squaredNorm();
    rotation += attempt.error.tail<3>().squaredNorm();
  }
  const double right = converged - wrong;
  constexpr double degrees = 180 / std::numbers::pi;
  return {{"tried", attempts.size()},
          {"converged", converged},
          {"false", wrong},
          {"rms_m", right > 0 ? json(std::sqrt(translation / right)) : json()},
          {"rms_deg", right > 0 ? json(degrees * std::sqrt(rotation / right)) : json()}};
}

json figures_of(const GraphBackEnd& back_end, const SampledScans& scans) {
  const SlamMap& map = back_end.map();
  const GraphErrors errors = graph_errors(map, scans.truth);
  constexpr double degrees = 180 / std::numbers::pi;
  const auto or_null = [](const ErrorStatistics& statistics, double factor) {
    return statistics.count > 0 ? json(factor * statistics.rmse) : json();
  };
  Index direct = 0, chained = 0, merges = 0, wrong = 0;
  for (const LoopClosure& closure : map.closures) {
    (closure.kind == ClosureKind::chained ? chained : closure.kind == ClosureKind::merge ? merges : direct)++;
    if (closure.verdict != ClosureVerdict::accepted) continue;  // rejected again as an outlier
    if (is_false((scans.T_true(closure.from, closure.to).inverse() * closure.T_from_to).log())) ++wrong;
  }
  return {{"ape_3d_m", or_null(errors.ape, 1)},
          {"ape_3d_deg", or_null(errors.ape_rotation, degrees)},
          {"ape_2d_m", or_null(errors.ape_2d, 1)},
          {"between_m", or_null(errors.between, 1)},
          {"between_deg", or_null(errors.between_rotation, degrees)},
          {"pairs", errors.pairs},
          {"frames", errors.frames},
          {"direct", direct},
          {"chained", chained},
          {"merges", merges},
          {"false", wrong},
          {"failed_optimizations", back_end.counts().failed_optimizations}};
}

json run_seed(std::uint64_t seed, const Measured& measured, const mapper::BackEndParts& parts) {
  DrawnWorld world(seed, measured, parts, visits(measured.drives.size(), measured.drives, {}, Rng(seed)));
  for (std::size_t i = 0; i < measured.drives.size(); ++i) world.drive();
  static_cast<void>(world.back_end().finish());
  json figures = figures_of(world.back_end(), world.scans());
  figures["seed"] = seed;
  return figures;
}

/// What keyframes cost, each `milliseconds`.
json cost_of(std::vector<double> milliseconds) {
  double total = 0;
  for (const double one : milliseconds) total += one;
  const double mean = total / static_cast<double>(milliseconds.size());
  const support::Spread spread = support::spread_of(std::move(milliseconds));
  return {{"keyframe_mean_ms", mean}, {"keyframe_p99_ms", spread.p99}, {"keyframe_max_ms", spread.max}};
}

/// Writes JSON as it grows, so that what is done is kept whatever happens.
class GrowingFile {
 public:
  GrowingFile(fs::path path, json& document) : path_(std::move(path)), document_(document) {}

  /// Writes the document as it is, unless that was done a moment ago.
  void update() {
    constexpr auto moment = std::chrono::seconds(2);
    const auto now = std::chrono::steady_clock::now();
    if (now - written_ < moment) return;
    written_ = now;
    AtomicFile file(path_);
    file.write(document_.dump(1) + "\n");
    file.commit();
  }

 private:
  fs::path path_;
  json& document_;
  std::chrono::steady_clock::time_point written_{};
};

/// Bytes of a map's file, which is written for that.
std::uintmax_t file_size_of(const SlamMap& map, fs::path path) {
  path += ".map";
  fs::remove(path);
  save_map(path, map);
  const std::uintmax_t size = fs::file_size(path);
  fs::remove(path);
  return size;
}

/// The first of 1, 2 and 5 times a power of ten that exceeds a number; 1000 at least.
Index next_size(Index keyframes) {
  for (Index power = 1000;; power *= 10)
    for (const Index factor : {1, 2, 5})
      if (factor * power > keyframes) return factor * power;
}

Index count_of(const SlamMap& map, ClosureKind kind) {
  return static_cast<Index>(std::ranges::count(map.closures, kind, &LoopClosure::kind));
}

/// What each of many sessions costs, and the last fifth of the keyframes when there are 1000, 2000, 5000 and so on.
/// Ctrl-C ends it after the present session.
void run_growth(const Arguments& arguments, const Measured& measured, const mapper::BackEndParts& parts, json& result) {
  const support::Interrupt interrupt("\nfinishing the session; press again to stop at once\n");
  support::Progress progress;
  GrowingFile file(arguments.out, result);
  const Rng rng(1);
  const auto sessions = static_cast<std::size_t>(arguments.growth);
  DrawnWorld world(1, measured, parts, visits(sessions, measured.drives, arguments.town, rng.fork(3)));
  std::vector<double> all;
  Index size = next_size(0);
  for (int session = 1; session <= arguments.growth && !interrupt.requested(); ++session) {
    const std::vector<double> milliseconds = world.drive();
    all.insert(all.end(), milliseconds.begin(), milliseconds.end());
    const SlamMap& map = world.back_end().map();
    json row = cost_of(milliseconds);
    row.update({{"session", session},
                {"keyframes", map.keyframes.size()},
                {"closures", map.closures.size()},
                {"peak_memory_bytes", support::peak_memory()}});
    result["growth"].push_back(row);
    if (to_index(all.size()) >= size) {
      row.update(cost_of(std::vector<double>(all.end() - size / 5, all.end())));
      row["map_bytes"] = file_size_of(map, arguments.out);
      result["sizes"].push_back(row);
      size = next_size(to_index(all.size()));
    }
    file.update();
    progress.update({.stage = "growth",
                     .done = session,
                     .total = arguments.growth,
                     .keyframes = to_index(map.keyframes.size()),
                     .direct_closures = count_of(map, ClosureKind::direct),
                     .chained_closures = count_of(map, ClosureKind::chained)});
  }
}

Measured measure(const Arguments& arguments) {
  mapper::MapperOptions of_run;
  mapper::configure(of_run, arguments.map / "config.toml", {});
  Measured measured;
  std::vector<Trajectory> truths;
  for (const fs::path& set : arguments.sets) {
    measured.drives.push_back(read_drive(set));
    truths.push_back(read_tum(set / "truth.tum"));
    measured.errors.push_back(measured.drives.back().step_errors());
  }
  const LoadedMap loaded = load_map(arguments.map / "map.cslam", {.scans = false});
  if (loaded.map.sessions.size() != arguments.sets.size())
    throw_input_error(arguments.map.string(), "", std::to_string(loaded.map.sessions.size()) + " sessions",
                      "give the recordings that the map was made from, in their order");
  measured.attempts = attempts_of(loaded.map, truths, of_run.back_end.chain.correlation);
  return measured;
}

json run(const Arguments& arguments) {
  mapper::MapperOptions options;
  mapper::configure(options, arguments.map / "config.toml", arguments.overrides);
  Measured measured = measure(arguments);
  constexpr double degrees = 180 / std::numbers::pi;
  json result{{"statistics",
               {{"step_rms_m", root_mean_square(measured.errors, 0, 3)},
                {"step_rms_deg", degrees * root_mean_square(measured.errors, 3, 3)},
                {"next_step_correlation", next_step_correlation(measured.errors, 0)},
                {"next_step_correlation_rotation", next_step_correlation(measured.errors, 3)},
                {"closures", statistics_of(measured.attempts.closures)},
                {"merges", statistics_of(measured.attempts.merges)}}},
              {"seeds", json::array()},
              {"growth", json::array()},
              {"sizes", json::array()}};
  for (int seed = 1; seed <= arguments.seeds; ++seed)
    result["seeds"].push_back(run_seed(static_cast<std::uint64_t>(seed), measured, options.back_end));
  for (const fs::path& set : arguments.more) measured.drives.push_back(read_drive(set));
  if (arguments.growth > 0) run_growth(arguments, measured, options.back_end, result);
  return result;
}

}  // namespace
}  // namespace chainslam::experiments

int main(int count, char** words) {
  using namespace chainslam;
  experiments::Arguments arguments;
  CLI::App app("The back end on odometry and closures drawn from what a run with scans has measured");
  app.add_option("MAP", arguments.map, "folder of `chainslam map`, with map.cslam and config.toml")->required();
  app.add_option("SET", arguments.sets, "the recordings that it was made from")->required();
  app.add_option("--out", arguments.out, "JSON file to write")->required();
  app.add_option("--set", arguments.overrides, "override a setting of the map's")->allow_extra_args(false);
  app.add_option("--seeds", arguments.seeds, "drawn worlds")->check(CLI::Range(0, 100000))->capture_default_str();
  app.add_option("--growth", arguments.growth, "also time so many sessions of one drawn world")
      ->check(CLI::Range(0, 10000));
  app.add_option("--passes", arguments.town.passes,
                 "these in a town that grows with them, at most so many at one place; 0: all at one place")
      ->check(CLI::Range(0, 1000))
      ->capture_default_str();
  app.add_option("--spacing", arguments.town.spacing, "of places of the town, as a share of the drives' extent")
      ->check(CLI::Range(0.05, 10.0))
      ->capture_default_str();
  app.add_option("--more", arguments.more, "recordings of further sessions, to drive in --growth after the SETs");
  CLI11_PARSE(app, count, words);
  return bench::write_table("graph_seeds", arguments.out, [&] { return experiments::run(arguments).dump(1) + "\n"; });
}
