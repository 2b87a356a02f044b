// The back end on odometry and closures that are drawn from what a run with scans has measured, many times: see
// README.md beside this file.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <iterator>
#include <nlohmann/json.hpp>
#include <numbers>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/io/map_archive.hpp"
#include "chainslam/io/trajectory_file.hpp"
#include "datasets/dataset.hpp"
#include "graph/drawn_world.hpp"
#include "graph/graph_errors.hpp"
#include "mapper/options.hpp"
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
  std::vector<std::string> overrides;
  int seeds = 20;
  int growth = 0;  ///< sessions of one world, timed
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
  DrawnWorld world(seed, measured, parts, measured.drives.size());
  for (std::size_t i = 0; i < measured.drives.size(); ++i) world.drive();
  static_cast<void>(world.back_end().finish());
  json figures = figures_of(world.back_end(), world.scans());
  figures["seed"] = seed;
  return figures;
}

/// What each of many sessions costs that drive the same streets again.
json run_growth(int sessions, const Measured& measured, const mapper::BackEndParts& parts) {
  DrawnWorld world(1, measured, parts, static_cast<std::size_t>(sessions));
  json rows = json::array();
  for (int session = 1; session <= sessions; ++session) {
    std::vector<double> milliseconds = world.drive();
    double total = 0;
    for (const double one : milliseconds) total += one;
    const support::Spread spread = support::spread_of(milliseconds);
    const SlamMap& map = world.back_end().map();
    rows.push_back({{"session", session},
                    {"keyframes", map.keyframes.size()},
                    {"closures", map.closures.size()},
                    {"keyframe_mean_ms", total / static_cast<double>(milliseconds.size())},
                    {"keyframe_p99_ms", spread.p99},
                    {"keyframe_max_ms", spread.max},
                    {"peak_memory_bytes", support::peak_memory()}});
  }
  return rows;
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
  const Measured measured = measure(arguments);
  constexpr double degrees = 180 / std::numbers::pi;
  json result{{"statistics",
               {{"step_rms_m", root_mean_square(measured.errors, 0, 3)},
                {"step_rms_deg", degrees * root_mean_square(measured.errors, 3, 3)},
                {"next_step_correlation", next_step_correlation(measured.errors, 0)},
                {"next_step_correlation_rotation", next_step_correlation(measured.errors, 3)},
                {"closures", statistics_of(measured.attempts.closures)},
                {"merges", statistics_of(measured.attempts.merges)}}},
              {"seeds", json::array()},
              {"growth", json::array()}};
  for (int seed = 1; seed <= arguments.seeds; ++seed)
    result["seeds"].push_back(run_seed(static_cast<std::uint64_t>(seed), measured, options.back_end));
  if (arguments.growth > 0) result["growth"] = run_growth(arguments.growth, measured, options.back_end);
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
  CLI11_PARSE(app, count, words);
  return bench::write_table("graph_seeds", arguments.out, [&] { return experiments::run(arguments).dump(1) + "\n"; });
}
