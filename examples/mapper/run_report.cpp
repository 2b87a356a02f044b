#include <algorithm>
#include <cstdio>
#include <future>
#include <optional>
#include <string>
#include <vector>

#include "chainslam/trajectory/trajectory.hpp"
#include "report_answers.hpp"
#include "results.hpp"
#include "run_report_tables.hpp"
#include "support/map_picture.hpp"
#include "support/report.hpp"
#include "support/report_data.hpp"

namespace chainslam::mapper {

namespace {

std::string milliseconds(double seconds) {
  char text[64];
  std::snprintf(text, sizeof text, seconds < 0.1 ? "%.1f ms" : "%.0f ms", 1e3 * seconds);
  return text;
}

/// The truth at the keyframes, brought into the map's frame by the alignment of the evaluation.
void add_truth(const RunOutcome& outcome, std::size_t run, support::ReportSession& session) {
  const std::optional<SE3d>& T_map_truth = outcome.sessions[run].T_map_truth;
  if (!T_map_truth) return;
  const SlamMap& map = *outcome.mapping.map;
  const Session& of = map.sessions[static_cast<std::size_t>(outcome.mapping.sessions[run].id.value)];
  std::vector<Eigen::Vector3d> positions;
  for (Index i = of.first_keyframe; i < of.end_keyframe(); ++i) {
    const Timestamp time = map.keyframes[static_cast<std::size_t>(i)].time;
    const auto pose = pose_at(*outcome.mapping.sessions[run].truth, time, seconds(2.0));
    if (!pose) return;  // the plots need one for each keyframe
    positions.emplace_back(*T_map_truth * pose->translation() + session.offset);
  }
  session.truth = std::move(positions);
}

void complete_sessions(const RunOutcome& outcome, support::ReportData& data) {
  for (support::ReportSession& session : data.sessions) session.loaded = true;
  for (std::size_t i = 0; i < outcome.mapping.sessions.size(); ++i) {
    support::ReportSession& session = data.sessions[static_cast<std::size_t>(outcome.mapping.sessions[i].id.value)];
    session.loaded = false;
    add_truth(outcome, i, session);
  }
}

std::string subtitle(const support::RunSummary& summary) {
  const Index loaded = to_index(std::ranges::count(summary.sessions, true, &support::SessionSummary::loaded));
  std::string text;
  if (summary.sessions.size() > 1) {
    text = counted(to_index(summary.sessions.size()), "session");
    if (loaded > 0) text += " (" + std::to_string(loaded) + " from saved maps)";
    text += ", ";
  }
  text += counted(summary.scans, "scan") + ", " + metres(summary.path_length) + ", " +
          counted(summary.keyframes, "keyframe");
  return text + (summary.interrupted ? "; interrupted before the data ended" : "");
}

/// Sessions that no merge joined to the first one's frame.
std::vector<std::string> unmerged(const support::RunSummary& summary) {
  std::vector<std::string> names;
  for (const support::SessionSummary& session : summary.sessions)
    if (session.frame != summary.sessions.front().frame) names.push_back(session.name);
  return names;
}

void add_figures(const RunOutcome& outcome, support::ReportData& data) {
  const support::RunSummary& summary = outcome.summary;
  data.figures = {{"Scans", std::to_string(summary.scans), std::to_string(summary.lost_frames) + " lost"},
                  {"Path", metres(summary.path_length), counted(summary.keyframes, "keyframe")}};
  if (summary.sessions.size() > 1)
    data.figures.push_back({"Sessions merged",
                            std::to_string(summary.sessions.size() - unmerged(summary).size()) + " of " +
                                std::to_string(summary.sessions.size()),
                            counted(summary.merges, "merge")});
  data.figures.push_back({"Direct closures", std::to_string(summary.direct_closures), "revisited places"});
  if (summary.chained_closures > 0 || summary.sessions.size() > 1)
    data.figures.push_back(
        {"Chained closures", std::to_string(summary.chained_closures), counted(summary.components.count, "component")});
  if (const auto& errors = outcome.optimized_errors)
    data.figures.push_back(
        {"Error", metres(errors->translation.rmse),
         outcome.odometry_errors ? "odometry alone " + metres(outcome.odometry_errors->translation.rmse) : ""});
  if (const auto& errors = outcome.inter_session_errors)
    data.figures.push_back(
        {"Error between sessions", metres(errors->translation.rmse), counted(errors->translation.count, "pair")});
  if (summary.back_end.keyframes > 0)
    data.figures.push_back({"Back end per keyframe", milliseconds(summary.back_end.seconds.p50),
                            "99 % within " + milliseconds(summary.back_end.seconds.p99)});
  if (summary.wall_seconds <= 0) return;  // a report that is made again
  char speed[64];
  std::snprintf(speed, sizeof speed, "%.1f x", summary.data_seconds / std::max(summary.wall_seconds, 1e-9));
  data.figures.push_back({"Speed", speed, "times real time"});
}

void add_warnings(const support::RunSummary& summary, support::ReportData& data) {
  for (const std::string& name : unmerged(summary))
    data.warnings.push_back(name + " was not merged with " + summary.sessions.front().name +
                            ": its position is unknown, and it is drawn next to the map");
  data.warnings.insert(data.warnings.end(), summary.notes.begin(), summary.notes.end());
}

void add_rows(const support::RunSummary& summary, support::ReportData& data) {
  const auto number = [](double value) {
    char text[64];
    std::snprintf(text, sizeof text, "%.4g", value);
    return std::string(text);
  };
  for (const support::GoalResult& goal : summary.goals)
    data.summary.emplace_back("goal " + goal.name, number(goal.value) + " (bound " + number(goal.bound) + "), " +
                                                       (goal.met ? "met" : "missed"));
  const support::Spread& alignments = summary.back_end.closure_alignments;
  if (summary.direct_closures > 0)
    data.summary.emplace_back("registrations per direct closure, median (largest)",
                              number(alignments.p50) + " (" + number(alignments.max) + ")");
  if (const std::string spacing = support::spacing_sentence(summary); !spacing.empty())
    data.summary.emplace_back("v / f_lc > r_lc, the paper's rule for closures", spacing);
  if (summary.peak_memory > 0)
    data.summary.emplace_back("peak memory", std::to_string(summary.peak_memory / 1'000'000) + " MB");
}

}  // namespace

std::future<support::ReportData> gather_report(const SlamMap& map, double map_voxel, bool now) {
  return std::async(now ? std::launch::async : std::launch::deferred,
                    [&map, map_voxel] { return support::report_data(map, map_voxel); });
}

void write_run_report(OutputFolder& folder, const RunOutcome& outcome, support::ReportData data) {
  const support::RunSummary& summary = outcome.summary;
  data.title = summary.dataset;
  data.subtitle = subtitle(summary);
  const support::Verdict verdict = support::verdict_of(summary);
  data.verdict = "Verdict: " + verdict.headline;
  data.failed = verdict.failed;
  add_answers(outcome, data);
  complete_sessions(outcome, data);
  add_figures(outcome, data);
  add_warnings(summary, data);
  add_rows(summary, data);
  add_tables(outcome, data);
  data.stages = summary.stages;
  data.plots = support::error_plots(data.sessions);
  data.plots.insert(data.plots.begin(), support::speed_plot(data.sessions));
  data.plots.push_back(support::match_plot(*outcome.mapping.map));
  data.plots.push_back(support::back_end_plot(outcome.mapping.figures.keyframe_seconds));
  std::erase_if(data.plots, [](const support::ReportPlot& plot) { return plot.series.empty(); });
  folder.file("map.png", [&](const FileTarget& target) { support::write_map_picture(target.path, data); });
  add_files(folder.path(), folder.target(), data);
  folder.file("report.html", [&](const FileTarget& target) { support::write_report(target.path, data); });
}

}  // namespace chainslam::mapper
