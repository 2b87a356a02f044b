#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/evaluation/ape.hpp"
#include "chainslam/evaluation/rpe.hpp"
#include "chainslam/io/file_system.hpp"
#include "evaluation_report.hpp"
#include "exit_code.hpp"
#include "trajectory_file.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

namespace {

enum class Associate { automatic, time, index, interpolate };

struct EvalOptions {
  std::vector<std::filesystem::path> files;
  AlignmentOptions alignment;
  Associate associate = Associate::automatic;
  NcltPoses nclt_poses = NcltPoses::stated;
  std::optional<double> max_difference;  ///< seconds
  std::string delta = "1frame";
  PairChoice pairs = PairChoice::consecutive;
  std::filesystem::path json;
  std::optional<double> max_ape;  ///< metres, of the rmse
  std::optional<double> max_rpe;  ///< metres, of the rmse
};

/// Reads "10m", "0.5m", "1frame", "5frames".
std::optional<RpeOptions> parse_delta(const std::string& text) {
  RpeOptions options;
  const char* end = text.data() + text.size();
  const auto [rest, error] = std::from_chars(text.data(), end, options.delta);
  const std::string unit(rest, end);
  if (error != std::errc{} || !(options.delta > 0) || !std::isfinite(options.delta)) return std::nullopt;
  if (unit != "m" && unit != "frame" && unit != "frames") return std::nullopt;
  options.unit = unit == "m" ? DeltaUnit::metres : DeltaUnit::frames;
  if (options.unit == DeltaUnit::frames && options.delta != std::floor(options.delta)) return std::nullopt;
  return options;
}

std::string span_text(const Trajectory& trajectory) {
  char text[96];
  std::snprintf(text, sizeof text, "%.3f to %.3f s", trajectory.times.front().to_seconds(),
                trajectory.times.back().to_seconds());
  return text;
}

/// Smallest difference between any two times of the two, seconds.
double smallest_difference(const Trajectory& reference, const Trajectory& estimate) {
  Duration smallest = Duration::max();
  for (const Timestamp time : estimate.times) {
    const auto after = std::lower_bound(reference.times.begin(), reference.times.end(), time);
    if (after != reference.times.end()) smallest = std::min(smallest, *after - time);
    if (after != reference.times.begin()) smallest = std::min(smallest, time - *std::prev(after));
  }
  return to_seconds(smallest);
}

[[noreturn]] void fail_unmatched(const EvaluatedSession& session, double allowed) {
  const Trajectory &reference = session.reference.trajectory, &estimate = session.estimate.trajectory;
  char found[256], remedy[256];
  std::snprintf(found, sizeof found, "times of %s, none within %g s of the reference's %s (nearest: %.6g s)",
                span_text(estimate).c_str(), allowed, span_text(reference).c_str(),
                smallest_difference(reference, estimate));
  std::snprintf(remedy, sizeof remedy,
                "check that both are of one drive and one clock, raise --max-difference, or use --associate index");
  throw_input_error(session.estimate.path.string(), "compared with " + session.reference.path.string(), found, remedy);
}

Associate chosen_association(const EvaluatedSession& session, Associate asked) {
  const bool times = session.reference.trajectory.has_times() && session.estimate.trajectory.has_times();
  if (asked == Associate::automatic) return times ? Associate::time : Associate::index;
  if (asked != Associate::index && !times) {
    const TrajectoryFile& file = session.reference.trajectory.has_times() ? session.estimate : session.reference;
    throw_input_error(file.path.string(), "", std::string("no times (") + format_name(file.format) + ")",
                      "use --associate index, or give a file with times");
  }
  return asked;
}

/// Joins the poses of one reference and one estimate.
MatchedTrajectories match(EvaluatedSession& session, const EvalOptions& options) {
  const Trajectory &reference = session.reference.trajectory, &estimate = session.estimate.trajectory;
  const Associate how = chosen_association(session, options.associate);
  if (how == Associate::index) {
    session.association = "index";
    if (reference.size() != estimate.size())
      throw_input_error(
          session.estimate.path.string(), "compared with " + session.reference.path.string(),
          std::to_string(estimate.size()) + " poses, where the reference has " + std::to_string(reference.size()),
          "poses without times must belong together one by one; give files with times, or cut one");
    session.matched = to_index(reference.size());
    return {reference, estimate};
  }
  if (how == Associate::interpolate) {
    session.association = "interpolate";
    const double max_gap = options.max_difference.value_or(1.0);
    InterpolatedMatch joined = match_interpolated(reference, estimate, seconds(max_gap));
    session.estimate_left_over = joined.estimate;
    session.matched = to_index(joined.trajectories.estimate.size());
    if (session.matched == 0) fail_unmatched(session, max_gap);
    return std::move(joined.trajectories);
  }
  session.association = "time";
  const double allowed = options.max_difference.value_or(0.01);
  const Association joined = associate_by_time(reference, estimate, {.max_difference = seconds(allowed)});
  session.reference_left_over = joined.reference;
  session.estimate_left_over = joined.estimate;
  session.largest_difference = to_seconds(joined.largest_difference);
  session.matched = to_index(joined.matches.size());
  if (session.matched == 0) fail_unmatched(session, allowed);
  return matched(reference, estimate, joined);
}

Evaluation evaluate(const EvalOptions& options) {
  Evaluation result;
  result.alignment = options.alignment;
  result.delta = options.delta;
  result.rpe_options = parse_delta(options.delta).value();
  result.rpe_options.pairs = options.pairs;
  std::vector<MatchedTrajectories> sessions;
  for (std::size_t i = 0; i + 1 < options.files.size(); i += 2) {
    EvaluatedSession session;
    session.reference = read_trajectory(options.files[i], options.nclt_poses);
    session.estimate = read_trajectory(options.files[i + 1], options.nclt_poses);
    sessions.push_back(match(session, options));
    result.sessions.push_back(std::move(session));
  }
  const AlignedSessions aligned = align_sessions(sessions, options.alignment);
  if (aligned.status == EvaluationStatus::degenerate_alignment)
    throw_input_error(options.files[1].string(), "",
                      std::to_string(result.sessions.front().matched) +
                          " matched poses that lie in one place or on one line, which fix no rotation",
                      "use --align origin or --align none");
  result.ape = ape(aligned);
  result.rpe = rpe(aligned, result.rpe_options);
  return result;
}

/// Compares the errors with what the user allows.
int verdict(const EvalOptions& options, const Evaluation& evaluation) {
  const auto misses = [](const char* name, const ErrorStatistics& errors, const std::optional<double>& limit) {
    if (!limit || (errors.count > 0 && errors.rmse <= *limit)) return false;
    if (errors.count == 0)
      std::fprintf(stderr, "missed: %s has no value to compare with the limit of %.6g m\n", name, *limit);
    else
      std::fprintf(stderr, "missed: %s rmse of %.6g m exceeds the limit of %.6g m\n", name, errors.rmse, *limit);
    return true;
  };
  const bool ape_missed = misses("APE", evaluation.ape.translation, options.max_ape);
  const bool rpe_missed = misses("RPE", evaluation.rpe.translation, options.max_rpe);
  return ape_missed || rpe_missed ? exit_goal_missed : exit_good;
}

int run(const EvalOptions& options) {
  const Evaluation evaluation = evaluate(options);
  std::fputs(evaluation_table(evaluation).c_str(), stdout);
  if (!options.json.empty()) {
    AtomicFile file(options.json);
    file.write(evaluation_json(evaluation));
    file.commit();
  }
  return verdict(options, evaluation);
}

/// An option that takes one of several words.
template <class Value>
void add_choice(CLI::App& verb, const std::string& name, Value& member, const std::string& help,
                std::vector<std::pair<std::string, Value>> choices) {
  std::string words;
  for (const auto& [word, value] : choices) words += (words.empty() ? "" : "|") + word;
  const auto assign = [name, words, choices, &member](const std::string& text) {
    const auto found =
        std::find_if(choices.begin(), choices.end(), [&](const auto& choice) { return choice.first == text; });
    if (found == choices.end()) throw CLI::ValidationError(name, "'" + text + "' is none of " + words);
    member = found->second;
  };
  verb.add_option_function<std::string>(name, assign, help)->option_text(words);
}

}  // namespace

CLI::App* add_eval(CLI::App& program, int& exit_code) {
  const auto options = std::make_shared<EvalOptions>();
  CLI::App* verb = program.add_subcommand("eval", "compare estimated trajectories with references, as evo does");
  verb->footer(
      "Formats are told by content: TUM, KITTI poses, EuRoC csv, NCLT ground truth csv. Several pairs are sessions of\n"
      "one map: they share one alignment, and relative errors do not reach from one into the next.\n"
      "Examples:\n"
      "  chainslam eval truth.tum map/trajectory.tum\n"
      "  chainslam eval KITTI_00_gt.txt KITTI_00_ORB.txt --align none --delta 10m\n"
      "  chainslam eval groundtruth_2012-01-08.csv map/trajectory.tum --nclt imu --associate interpolate\n"
      "  chainslam eval truth1.csv session1.tum truth2.csv session2.tum --max-difference 0.2 --project xy --json "
      "e.json");
  verb->add_option("files", options->files, "REFERENCE ESTIMATE, once for each session")
      ->required()
      ->option_text("PATH PATH ...")
      ->expected(2, CLI::detail::expected_max_vector_size);
  add_choice<Alignment>(
      *verb, "--align", options->alignment.align,
      "transform of the estimate that is fitted before errors are taken: se3 (default), sim3 (with scale),\n"
      "origin (the first poses agree), none",
      {{"none", Alignment::none}, {"origin", Alignment::origin}, {"se3", Alignment::se3}, {"sim3", Alignment::sim3}});
  add_choice<bool>(*verb, "--project", options->alignment.project_xy, "xy: lay poses flat before they are aligned",
                   {{"xy", true}, {"none", false}});
  add_choice<Associate>(
      *verb, "--associate", options->associate,
      "which poses belong together: time (nearest; default where both have times), index (default else),\n"
      "interpolate (the reference is interpolated to the estimate's times)",
      {{"time", Associate::time}, {"index", Associate::index}, {"interpolate", Associate::interpolate}});
  verb->add_option("--max-difference", options->max_difference,
                   "largest difference of the times of two poses that are joined (default 0.01), or with interpolate\n"
                   "the longest gap in the reference (default 1)")
      ->option_text("SECONDS")
      ->check(CLI::Range(0.0, 1e9).description(""));
  verb->add_option("--delta", options->delta, "distance of relative errors, as in 10m or 1frame (default)")
      ->option_text("DELTA")
      ->check(CLI::Validator(
          [](std::string& text) {
            return parse_delta(text) ? std::string{} : "'" + text + "' is no distance: write 10m or 1frame";
          },
          ""));
  add_choice<PairChoice>(*verb, "--pairs", options->pairs, "which pairs of that distance: consecutive (default) or all",
                         {{"consecutive", PairChoice::consecutive}, {"all", PairChoice::all}});
  add_choice<NcltPoses>(*verb, "--nclt", options->nclt_poses,
                        "what NCLT's csv gives: its poses as stated, z down (default), or imu: z up, of the inertial\n"
                        "unit, as this program's maps have them",
                        {{"stated", NcltPoses::stated}, {"imu", NcltPoses::imu}});
  verb->add_option("--json", options->json, "write all figures to this file as well")->option_text("FILE");
  verb->add_option("--max-ape", options->max_ape, "exit with 5 if the APE's rmse exceeds this")->option_text("METRES");
  verb->add_option("--max-rpe", options->max_rpe, "exit with 5 if the RPE's rmse exceeds this")->option_text("METRES");
  verb->callback([options, &exit_code] {
    if (options->files.size() % 2 != 0)
      throw CLI::ValidationError("files", "each REFERENCE needs its ESTIMATE: an even number of files");
    exit_code = run(*options);
  });
  return verb;
}

}  // namespace chainslam::mapper
