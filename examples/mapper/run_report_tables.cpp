#include "run_report_tables.hpp"

#include <algorithm>
#include <cstdio>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/trajectory/kitti_errors.hpp"
#include "support/imu_calibration.hpp"
#include "support/session_joins.hpp"

namespace chainslam::mapper {

std::string metres(double value) {
  char text[64];
  std::snprintf(text, sizeof text, value < 10 ? "%.3f m" : "%.1f m", value);
  return text;
}

std::string counted(Index count, const std::string& thing) {
  return std::to_string(count) + " " + thing + (count == 1 ? "" : "s");
}

namespace {

/// Where frames were lost or doubtful; the longest if there are many.
void add_interval_table(const support::RunSummary& summary, support::ReportData& data) {
  constexpr std::size_t most = 40;
  std::vector<std::pair<std::string, support::FrameInterval>> intervals;
  for (const support::SessionSummary& session : summary.sessions)
    for (const support::FrameInterval& interval : session.health.intervals)
      intervals.emplace_back(session.name, interval);
  if (intervals.empty()) return;
  std::ranges::stable_sort(intervals, [](const auto& a, const auto& b) {
    if (a.second.concern != b.second.concern) return a.second.concern < b.second.concern;
    return a.second.frames > b.second.frames;
  });
  support::ReportTable table{.title = "Lost and doubtful intervals",
                             .heads = {"Cause", "Session", "From", "To", "Scans", "Distance", "Map restarts"}};
  const auto time = [](double value) {
    char text[64];
    std::snprintf(text, sizeof text, "%.1f s", value);
    return std::string(text);
  };
  for (std::size_t i = 0; i < std::min(most, intervals.size()); ++i) {
    const auto& [session, interval] = intervals[i];
    table.rows.push_back({support::name_of(interval.concern), session, time(interval.begin), time(interval.end),
                          std::to_string(interval.frames), metres(interval.distance),
                          std::to_string(interval.restarts)});
  }
  if (intervals.size() > most)
    table.rows.push_back({std::to_string(intervals.size() - most) + " more in summary.json", "", "", "", "", "", ""});
  data.tables.push_back(std::move(table));
}

/// Where the map contradicts odometry; where by most if there are many.
void add_failure_table(const support::RunSummary& summary, support::ReportData& data) {
  constexpr std::size_t most = 40;
  std::vector<std::pair<std::string, support::OdometryFailure>> failures;
  for (const support::SessionSummary& session : summary.sessions)
    for (const support::OdometryFailure& failure : session.failures) failures.emplace_back(session.name, failure);
  if (failures.empty()) return;
  std::ranges::stable_sort(failures, [](const auto& a, const auto& b) { return a.second.off > b.second.off; });
  support::ReportTable table{.title = "Where odometry failed: steps that closures or fixes contradict",
                             .heads = {"Session", "From", "To", "Distance", "Off by", "rotation"}};
  const auto text = [](const char* format, double value) {
    char written[64];
    std::snprintf(written, sizeof written, format, value);
    return std::string(written);
  };
  for (std::size_t i = 0; i < std::min(most, failures.size()); ++i) {
    const auto& [session, failure] = failures[i];
    table.rows.push_back({session, text("%.1f s", failure.begin), text("%.1f s", failure.end), metres(failure.distance),
                          metres(failure.off), text("%.2f°", failure.turned * 180 / std::numbers::pi)});
  }
  if (failures.size() > most)
    table.rows.push_back({std::to_string(failures.size() - most) + " more in summary.json", "", "", "", "", ""});
  data.tables.push_back(std::move(table));
}

/// What odometry relied on of each session's IMU, and what the scans say of its clock and axes.
void add_imu_table(const support::RunSummary& summary, support::ReportData& data) {
  support::ReportTable table{.title = "IMU: share of frames that use it, and what the scans say of its clock and axes",
                             .heads = {"Session", "Full IMU", "Gyroscope only", "LiDAR only", "imu.time_offset",
                                       "T_body_lidar's rotation", "Used"}};
  for (const support::SessionSummary& session : summary.sessions) {
    const support::ImuUseCounts& use = session.health.imu_use;
    if (use.frames() == 0) continue;
    const auto percent = [&](Index count) {
      char text[32];
      std::snprintf(text, sizeof text, "%.1f %%", 100 * use.share(count));
      return std::string(text);
    };
    std::vector<std::string> row{session.name, percent(use.all), percent(use.gyroscope), percent(use.scans_only)};
    if (const auto& calibration = session.calibration) {
      const Eigen::Vector3d angles = support::roll_pitch_yaw_deg(calibration->applied_T_body_lidar().rotation());
      char used[96];
      std::snprintf(used, sizeof used, "%.3f s; roll %.1f, pitch %.1f, yaw %.1f deg",
                    calibration->applied_time_offset(), angles.x(), angles.y(), angles.z());
      row.insert(row.end(), {time_offset_text(*calibration), rotation_text(*calibration), used});
    } else {
      row.insert(row.end(), {"–", "–", "as given"});
    }
    table.rows.push_back(std::move(row));
  }
  if (!table.rows.empty()) data.tables.push_back(std::move(table));
}

/// How sessions were joined, and what was taken back.
void add_join_table(const SlamMap& map, support::ReportData& data) {
  support::ReportTable table{.title = "What joins sessions",
                             .heads = {"Sessions", "Joined by", "Rejected, reverted or refused"}};
  const auto name = [&](SessionId id) { return data.sessions[static_cast<std::size_t>(id.value)].name; };
  for (const support::SessionJoin& join : support::session_joins(map)) {
    const std::string doubts = support::doubts_of(join);
    table.rows.push_back(
        {name(join.first) + ", " + name(join.second), support::evidence_of(join), doubts.empty() ? "–" : doubts});
  }
  if (!table.rows.empty()) data.tables.push_back(std::move(table));
}

/// Errors of each session, of all together and between them.
void add_error_table(const RunOutcome& outcome, support::ReportData& data) {
  constexpr double degrees = 180 / std::numbers::pi;
  support::ReportTable table{.title = "Errors against the truth, RMS",
                             .heads = {"", "Odometry alone", "rotation", "Optimized", "rotation"}};
  const auto pair = [](const ErrorStatistics& translation, const ErrorStatistics& rotation) {
    char text[64];
    std::snprintf(text, sizeof text, "%.2f°", degrees * rotation.rmse);
    return std::vector<std::string>{metres(translation.rmse), text};
  };
  const auto add = [&](const std::string& name, const auto& odometry, const auto& optimized) {
    std::vector<std::string> row{name};
    for (const std::vector<std::string>& cells : {odometry, optimized})
      row.insert(row.end(), cells.begin(), cells.end());
    table.rows.push_back(std::move(row));
  };
  const std::vector<std::string> none{"–", "–"};
  const bool several = outcome.sessions.size() > 1;
  for (std::size_t i = 0; several && i < outcome.sessions.size(); ++i) {
    const auto &odometry = outcome.sessions[i].odometry_errors, &optimized = outcome.sessions[i].optimized_errors;
    if (!odometry && !optimized) continue;
    add(outcome.mapping.sessions[i].name + ", aligned alone",
        odometry ? pair(odometry->ape.translation, odometry->ape.rotation) : none,
        optimized ? pair(optimized->ape.translation, optimized->ape.rotation) : none);
  }
  if (const auto& odometry = outcome.odometry_errors, &optimized = outcome.optimized_errors; odometry || optimized) {
    const Index alignments = optimized ? optimized->alignments : 0;
    add(several ? "all; optimized poses under " + counted(alignments, "alignment") : "rigidly aligned",
        odometry ? pair(odometry->translation, odometry->rotation) : none,
        optimized ? pair(optimized->translation, optimized->rotation) : none);
  }
  if (const auto& between = outcome.inter_session_errors)
    add("between sessions, at one place", none, pair(between->translation, between->rotation));
  if (!table.rows.empty()) data.tables.push_back(std::move(table));
}

/// KITTI's relative errors of each session and of all together, where paths are long enough.
void add_kitti_table(const RunOutcome& outcome, support::ReportData& data) {
  constexpr double degrees = 180 / std::numbers::pi;
  support::ReportTable table{.title = "Relative errors over 100 to 800 m (KITTI's metric)",
                             .heads = {"", "Odometry alone", "rotation", "Optimized", "rotation"}};
  const auto add = [&](const std::string& name, const auto& odometry, const auto& optimized) {
    std::vector<std::string> row{name};
    for (const auto* errors : {&odometry, &optimized}) {
      const bool known = *errors && (*errors)->kitti.status == EvaluationStatus::evaluated;
      char percent[64] = "–", rotation[64] = "–";
      if (known) std::snprintf(percent, sizeof percent, "%.3f %%", 100 * (*errors)->kitti.translation);
      if (known) std::snprintf(rotation, sizeof rotation, "%.3f°/100 m", 100 * degrees * (*errors)->kitti.rotation);
      row.insert(row.end(), {percent, rotation});
    }
    if (row[1] != "–" || row[3] != "–") table.rows.push_back(std::move(row));
  };
  for (std::size_t i = 0; outcome.sessions.size() > 1 && i < outcome.sessions.size(); ++i)
    add(outcome.mapping.sessions[i].name, outcome.sessions[i].odometry_errors, outcome.sessions[i].optimized_errors);
  add("all segments", outcome.odometry_errors, outcome.optimized_errors);
  if (!table.rows.empty()) data.tables.push_back(std::move(table));
}

}  // namespace

void add_tables(const RunOutcome& outcome, support::ReportData& data) {
  add_join_table(*outcome.mapping.map, data);
  add_interval_table(outcome.summary, data);
  add_failure_table(outcome.summary, data);
  add_imu_table(outcome.summary, data);
  add_error_table(outcome, data);
  add_kitti_table(outcome, data);
}

}  // namespace chainslam::mapper
