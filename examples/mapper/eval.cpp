#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/error.hpp"
#include "chainslam/trajectory/kitti_errors.hpp"
#include "chainslam/trajectory/pose_errors.hpp"
#include "end_on_interrupt.hpp"
#include "evaluation_report.hpp"
#include "exit_code.hpp"
#include "output.hpp"
#include "trajectory_file.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

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

namespace {

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
MatchedTrajectories match(EvaluatedSession& session, const EvalArguments& options) {
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

Evaluation evaluate(const EvalArguments& options) {
  Evaluation result;
  result.alignment = options.alignment;
  result.delta = options.delta;
  result.rpe_options = parse_delta(options.delta).value();
  result.rpe_options.pairs = options.pairs;
  result.kitti_options.step = options.kitti_step;
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
  result.kitti = kitti_errors(aligned, result.kitti_options);
  return result;
}

/// Compares the errors with what the user allows.
int verdict(const EvalArguments& options, const Evaluation& evaluation) {
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

}  // namespace

int run(const EvalArguments& options) {
  require_free(options.json, options.overwrite);
  const EndOnInterrupt interrupt(options.json);
  const Evaluation evaluation = evaluate(options);
  std::fputs(printable(evaluation_table(evaluation), true).c_str(), stdout);
  Output output(options.overwrite);
  if (!options.json.empty())
    output.file(options.json, [&](const FileTarget& target) {
      AtomicFile file(target);
      file.write(evaluation_json(evaluation));
      file.commit();
    });
  return output.exit_code(verdict(options, evaluation));
}

}  // namespace chainslam::mapper
