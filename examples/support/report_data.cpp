#include "support/report_data.hpp"

#include <Eigen/Geometry>
#include <algorithm>
#include <cstddef>
#include <map>
#include <optional>
#include <span>
#include <utility>

#include "chainslam/cloud/cell_table.hpp"
#include "chainslam/core/timestamp.hpp"
#include "chainslam/slam/connected_components.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "chainslam/trajectory/trajectory.hpp"
#include "support/frame_health.hpp"

namespace chainslam::support {
namespace {

std::size_t at(Index i) { return static_cast<std::size_t>(i); }

/// The path of odometry, corrected at the keyframes, from the last frame before scans were lost to the first after.
void add_lost_stretches(const SlamMap& map, const Session& session, ReportSession& result) {
  const auto frames = map.frames.of(session.id);
  Trajectory odometry;
  for (const FrameRecord& frame : frames) {
    odometry.times.push_back(frame.time);
    odometry.poses.push_back(frame.T_odom_body);
  }
  const Trajectory corrected = corrected_trajectory(
      odometry, std::span(map.keyframes).subspan(at(session.first_keyframe), at(session.keyframes)));
  for (const FrameInterval& interval : health_of(frames).intervals) {
    if (interval.concern != FrameConcern::lost) continue;
    std::vector<Eigen::Vector3d>& stretch = result.lost.emplace_back();
    for (Index i = std::max<Index>(interval.first - 1, 0);
         i <= std::min(interval.last + 1, to_index(frames.size()) - 1); ++i)
      stretch.emplace_back(corrected.poses[at(i)].translation() + result.offset);
  }
}

ReportSession session_of(const Session& session, const SlamMap& map, const Eigen::Vector3d& offset) {
  ReportSession result{.name = session.name, .frame = std::max<Index>(session.frame.value, 0), .offset = offset};
  if (session.keyframes == 0) return result;
  const Keyframe& first = map.keyframes[at(session.first_keyframe)];
  const SE3d T_map_odom = odometry_placement(map, session);
  for (Index i = session.first_keyframe; i < session.end_keyframe(); ++i) {
    const Keyframe& keyframe = map.keyframes[at(i)];
    result.times.push_back(to_seconds(keyframe.time - first.time));
    result.optimized.emplace_back(keyframe.T_map_body.translation() + offset);
    result.odometry.emplace_back((T_map_odom * keyframe.T_odom_body).translation() + offset);
  }
  add_lost_stretches(map, session, result);
  return result;
}

/// How far each frame is moved so that it lies to the right of the ones before; by the session that defines it.
std::map<SessionId, Eigen::Vector3d> side_by_side(const SlamMap& map) {
  constexpr double gap = 120.0;  // metres between the keyframes of two frames: each has its surroundings
  std::map<SessionId, Eigen::AlignedBox3d> boxes;
  for (const Session& session : map.sessions)
    for (Index i = session.first_keyframe; i < session.end_keyframe(); ++i)
      boxes[session.frame].extend(map.keyframes[at(i)].T_map_body.translation());
  std::map<SessionId, Eigen::Vector3d> offsets;
  double right = 0.0, bottom = 0.0;
  for (const auto& [frame, box] : boxes) {
    Eigen::Vector3d& offset = offsets[frame] = Eigen::Vector3d::Zero();
    if (offsets.size() == 1)
      bottom = box.min().y();
    else
      offset.head<2>() = Eigen::Vector2d(right + gap - box.min().x(), bottom - box.min().y());
    right = box.max().x() + offset.x();
  }
  return offsets;
}

std::vector<ReportRefusal> refusals_of(const SlamMap& map) {
  std::map<std::pair<ClosureVerdict, ClosureKind>, Index> counts;
  for (const LoopClosure& refusal : map.refusals) ++counts[{refusal.verdict, refusal.kind}];
  std::vector<ReportRefusal> refusals;
  for (const auto& [what, count] : counts)
    refusals.push_back({.reason = name_of(what.first), .count = count, .kind = what.second});
  return refusals;
}

/// The map's points, the first of each session in each cell. Cells grow when there are too many: pages and pictures
/// show fewer, and a map of a hundred million points is not to be held twice.
class MapPoints {
 public:
  MapPoints(ReportData& data, double voxel_size) : data_(data), voxel_size_(voxel_size) {}

  void add(const Keyframe& keyframe, const Eigen::Vector3d& offset) {
    const auto cloud = keyframe.cloud.load();
    if (!cloud) return;
    const auto session = static_cast<std::uint8_t>(std::min<Index>(keyframe.session.value, 255));
    for (const Eigen::Vector3f& position : cloud->positions) {
      const Eigen::Vector3d point = keyframe.T_map_body * Eigen::Vector3d(position.cast<double>());
      add((point + offset - data_.points_origin).cast<float>(), session);
    }
    while (data_.points.size() > largest) grow_cells();
  }

 private:
  static constexpr std::size_t largest = 2'000'000;

  void add(const Eigen::Vector3f& point, std::uint8_t session) {
    if (data_.point_sessions.empty() || data_.point_sessions.back() != session) cells_ = {};
    const std::optional<Cell> cell = cell_of(point.cast<double>() / voxel_size_);
    if (!cell || !cells_.insert(*cell)) return;
    data_.points.push_back(point);
    data_.point_sessions.push_back(session);
  }

  void grow_cells() {
    voxel_size_ *= 1.5;
    const auto points = std::exchange(data_.points, {});
    const auto sessions = std::exchange(data_.point_sessions, {});
    for (std::size_t i = 0; i < points.size(); ++i) add(points[i], sessions[i]);
  }

  ReportData& data_;
  double voxel_size_;
  CellSet cells_;  ///< of the session at hand
};

ReportSeries error_series(const std::string& name, const ReportSession& session, Index color,
                          const std::vector<Eigen::Vector3d>& positions) {
  ReportSeries series{.name = name, .x = session.times, .color = color};
  for (std::size_t i = 0; i < positions.size(); ++i) series.y.push_back((positions[i] - session.truth[i]).norm());
  return series;
}

ReportPlot error_plot(const std::string& title) {
  return {.title = title, .x_label = "time in session (s)", .y_label = "error (m)"};
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
    case ClosureVerdict::low_fitness:
      return "low fitness";
    case ClosureVerdict::inconsistent:
      return "contradicts the map";
    case ClosureVerdict::unconfirmed:
      return "not confirmed by a second place";
    case ClosureVerdict::reverted:
      return "merge reverted";
    case ClosureVerdict::against_fixes:
      return "contradicts the fixes";
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
  const auto offsets = side_by_side(map);
  const auto offset_of = [&](const Session& session) -> Eigen::Vector3d {
    const auto found = offsets.find(session.frame);
    return found == offsets.end() ? Eigen::Vector3d::Zero() : found->second;
  };
  for (const Session& session : map.sessions) data.sessions.push_back(session_of(session, map, offset_of(session)));
  for (const LoopClosure& closure : map.closures)
    data.closures.push_back({.from = closure.from.value,
                             .to = closure.to.value,
                             .kind = closure.kind,
                             .score = closure.mean_squared_error});
  data.refusals = refusals_of(map);
  data.components = adjacency_components(map);

  if (!map.keyframes.empty()) data.points_origin = map.keyframes.front().T_map_body.translation();
  MapPoints points(data, voxel_size);
  for (const Session& session : map.sessions)
    for (Index i = session.first_keyframe; i < session.end_keyframe(); ++i)
      points.add(map.keyframes[at(i)], offset_of(session));

  const bool has_times = std::ranges::any_of(data.sessions, [](const ReportSession& s) { return s.times.size() > 1; });
  if (has_times) data.plots.push_back(speed_plot(data.sessions));
  return data;
}

SE3d odometry_placement(const SlamMap& map, const Session& session) {
  const auto contains = [&](KeyframeId id) {
    return id.value >= session.first_keyframe && id.value < session.end_keyframe();
  };
  const auto pose = [&](KeyframeId id) -> const Keyframe& { return map.keyframes[at(id.value)]; };
  const LoopClosure* merge = nullptr;
  if (session.frame != session.id)
    for (const LoopClosure& closure : map.closures) {
      if (closure.kind != ClosureKind::merge || contains(closure.from) == contains(closure.to)) continue;
      if (contains(closure.to) || !merge) merge = &closure;
      if (contains(closure.to)) break;
    }
  if (!merge) {
    const Keyframe& first = map.keyframes[at(session.first_keyframe)];
    return first.T_map_body * first.T_odom_body.inverse();
  }
  const Keyframe &from = pose(merge->from), &to = pose(merge->to);
  return contains(merge->to) ? from.T_map_body * merge->T_from_to * to.T_odom_body.inverse()
                             : to.T_map_body * merge->T_from_to.inverse() * from.T_odom_body.inverse();
}

std::vector<ReportComponent> adjacency_components(const SlamMap& map) {
  ConnectedComponents connected(to_index(map.keyframes.size()));
  for (const LoopClosure& closure : map.closures)
    if (closure.is_factor()) connected.connect(closure.from.value, closure.to.value);

  std::map<Index, ReportComponent> by_node;  // that stands for the component
  for (const Keyframe& keyframe : map.keyframes) {
    if (connected.size_of(keyframe.id.value) < 2) continue;
    ReportComponent& component = by_node[connected.component_of(keyframe.id.value)];
    component.keyframes.push_back(keyframe.id.value);
    const Index session = keyframe.session.value;
    if (component.sessions.empty() || component.sessions.back() != session) component.sessions.push_back(session);
  }
  for (const LoopClosure& closure : map.closures)
    if (closure.is_factor()) ++by_node[connected.component_of(closure.from.value)].closures;

  std::vector<ReportComponent> components;
  for (auto& [node, component] : by_node) components.push_back(std::move(component));
  std::ranges::sort(components, [](const ReportComponent& a, const ReportComponent& b) {
    if (a.keyframes.size() != b.keyframes.size()) return a.keyframes.size() > b.keyframes.size();
    return a.keyframes.front() < b.keyframes.front();
  });
  return components;
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
      series.y.push_back((session.optimized[i] - session.optimized[i - 1]).norm() / duration);
    }
    if (!series.x.empty()) plot.series.push_back(std::move(series));
  }
  return plot;
}

ReportPlot match_plot(const SlamMap& map) {
  ReportPlot plot{.title = "Matched points of a scan", .x_label = "time in session (s)", .y_label = "share (%)"};
  for (const Session& session : map.sessions) {
    ReportSeries series{.name = session.name, .color = session.id.value};
    const auto frames = map.frames.of(session.id);
    for (const FrameRecord& frame : frames) {
      if (frame.health.points == 0 || frame.health.iterations == 0) continue;  // recorded, or the first
      series.x.push_back(to_seconds(frame.time - frames.front().time));
      series.y.push_back(100.0 * frame.health.matches / frame.health.points);
    }
    if (!series.x.empty()) plot.series.push_back(std::move(series));
  }
  return plot;
}

std::vector<ReportPlot> error_plots(const std::vector<ReportSession>& sessions) {
  ReportPlot together = error_plot("Distance from the truth");
  std::vector<ReportPlot> apart;
  for (std::size_t s = 0; s < sessions.size(); ++s) {
    const ReportSession& session = sessions[s];
    if (session.truth.empty() || session.times.empty()) continue;
    const Index color = to_index(s);
    together.series.push_back(error_series(session.name, session, color, session.optimized));
    ReportPlot& plot = apart.emplace_back(error_plot("Distance from the truth: " + session.name));
    plot.series.push_back(error_series(session.name + ", optimized", session, color, session.optimized));
    if (session.odometry.empty()) continue;
    plot.series.push_back(error_series(session.name + ", odometry alone", session, color, session.odometry));
    plot.series.back().dashed = true;
  }
  if (apart.size() > 1) apart.insert(apart.begin(), std::move(together));
  if (apart.size() == 1) apart.front().title = together.title;
  return apart;
}

ReportPlot back_end_plot(const std::vector<double>& keyframe_seconds) {
  ReportPlot plot{.title = "Back end, per keyframe", .x_label = "keyframe of this run", .y_label = "time (ms)"};
  if (keyframe_seconds.empty()) return plot;
  ReportSeries& series = plot.series.emplace_back(ReportSeries{.name = "back end"});
  for (std::size_t i = 0; i < keyframe_seconds.size(); ++i) {
    series.x.push_back(static_cast<double>(i));
    series.y.push_back(1e3 * keyframe_seconds[i]);
  }
  return plot;
}

}  // namespace chainslam::support
