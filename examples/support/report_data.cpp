#include "support/report_data.hpp"

#include <algorithm>
#include <cstddef>
#include <map>
#include <optional>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/core/timestamp.hpp"

namespace chainslam::support {
namespace {

ReportSession session_of(const Session& session, const SlamMap& map) {
  ReportSession result{.name = session.name};
  if (session.keyframes == 0) return result;
  const Keyframe& first = map.keyframes[static_cast<std::size_t>(session.first_keyframe)];
  const SE3d T_map_odom = first.T_map_body * first.T_odom_body.inverse();
  for (Index i = session.first_keyframe; i < session.first_keyframe + session.keyframes; ++i) {
    const Keyframe& keyframe = map.keyframes[static_cast<std::size_t>(i)];
    result.times.push_back(to_seconds(keyframe.time - first.time));
    result.optimised.push_back(keyframe.T_map_body.translation());
    result.odometry.push_back((T_map_odom * keyframe.T_odom_body).translation());
  }
  return result;
}

/// Adds the keyframe's points that are the first in their cells.
void add_points(const Keyframe& keyframe, double voxel_size, CellTable& cells, ReportData& data) {
  if (!keyframe.cloud) return;
  for (const Eigen::Vector3f& position : keyframe.cloud->positions) {
    const Eigen::Vector3d point = keyframe.T_map_body * Eigen::Vector3d(position.cast<double>());
    const std::optional<Cell> cell = cell_of(point / voxel_size);
    if (!cell || !cells.insert(*cell, cells.size()).second) continue;
    data.points.emplace_back((point - data.points_origin).cast<float>());
    data.point_sessions.push_back(static_cast<std::uint8_t>(std::min<Index>(keyframe.session.value, 255)));
  }
}

ReportSeries error_series(const std::string& name, const ReportSession& session,
                          const std::vector<Eigen::Vector3d>& positions) {
  ReportSeries series{.name = session.name + ", " + name, .x = session.times};
  for (std::size_t i = 0; i < positions.size(); ++i) series.y.push_back((positions[i] - session.truth[i]).norm());
  return series;
}

}  // namespace

std::string name_of(ClosureVerdict verdict) {
  switch (verdict) {
    case ClosureVerdict::accepted:
      return "accepted";
    case ClosureVerdict::not_converged:
      return "registration did not converge";
    case ClosureVerdict::too_few_inliers:
      return "too few inliers";
    case ClosureVerdict::high_residual:
      return "high residual";
    case ClosureVerdict::implausible:
      return "implausible correction";
  }
  return "unknown";
}

std::string name_of(ClosureKind kind) {
  switch (kind) {
    case ClosureKind::direct:
      return "direct";
    case ClosureKind::chained:
      return "chained";
    case ClosureKind::merge:
      return "merge";
  }
  return "unknown";
}

ReportData report_data(const SlamMap& map, double voxel_size) {
  ReportData data;
  for (const Session& session : map.sessions) data.sessions.push_back(session_of(session, map));
  for (const LoopClosure& closure : map.closures)
    data.closures.push_back({.from = closure.from.value,
                             .to = closure.to.value,
                             .kind = closure.kind,
                             .score = closure.mean_squared_error});
  std::map<ClosureVerdict, Index> refusals;
  for (const LoopClosure& refusal : map.refusals) ++refusals[refusal.verdict];
  for (const auto& [verdict, count] : refusals) data.refusals.push_back({.reason = name_of(verdict), .count = count});

  if (!map.keyframes.empty()) data.points_origin = map.keyframes.front().T_map_body.translation();
  std::map<SessionId, CellTable> cells;
  for (const Keyframe& keyframe : map.keyframes) add_points(keyframe, voxel_size, cells[keyframe.session], data);

  const bool has_times = std::ranges::any_of(data.sessions, [](const ReportSession& s) { return s.times.size() > 1; });
  if (has_times) data.plots.push_back(speed_plot(data.sessions));
  return data;
}

ReportPlot speed_plot(const std::vector<ReportSession>& sessions) {
  ReportPlot plot{.title = "Speed between keyframes", .x_label = "time in session (s)", .y_label = "speed (m/s)"};
  for (std::size_t s = 0; s < sessions.size(); ++s) {
    const ReportSession& session = sessions[s];
    ReportSeries series{.name = session.name, .color = to_index(s)};
    for (std::size_t i = 1; i < session.times.size(); ++i) {
      const double duration = session.times[i] - session.times[i - 1];
      if (!(duration > 0.0)) continue;
      series.x.push_back(0.5 * (session.times[i] + session.times[i - 1]));
      series.y.push_back((session.optimised[i] - session.optimised[i - 1]).norm() / duration);
    }
    if (!series.x.empty()) plot.series.push_back(std::move(series));
  }
  return plot;
}

ReportPlot error_plot(const std::vector<ReportSession>& sessions) {
  ReportPlot plot{.title = "Distance from the truth", .x_label = "time in session (s)", .y_label = "error (m)"};
  for (std::size_t s = 0; s < sessions.size(); ++s) {
    const ReportSession& session = sessions[s];
    if (session.truth.empty() || session.times.empty()) continue;
    plot.series.push_back(error_series("optimised", session, session.optimised));
    plot.series.back().color = to_index(s);
    if (session.odometry.empty()) continue;
    plot.series.push_back(error_series("odometry alone", session, session.odometry));
    plot.series.back().color = to_index(s);
    plot.series.back().dashed = true;
  }
  return plot;
}

}  // namespace chainslam::support
