#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/slam/slam_map.hpp"
#include "support/statistics.hpp"

namespace chainslam::support {

/// A figure that the report shows large, at its top.
struct ReportFigure {
  std::string label{};  ///< "Chained closures"
  std::string value{};  ///< "118"
  std::string note{};   ///< small, below: "from 41 direct ones"
};

/// A file next to the report.
struct ReportFile {
  std::string name{};
  std::string what{};  ///< a few words, or nothing
};

/// One session's keyframes. All positions in the map frame, metres, moved by `offset`.
struct ReportSession {
  std::string name{};
  std::vector<double> times{};               ///< seconds since the session's start; empty or one per keyframe
  std::vector<Eigen::Vector3d> optimized{};  ///< one per keyframe
  std::vector<Eigen::Vector3d> odometry{};   ///< as the front end gave it, laid on the map; empty or one per keyframe
  std::vector<Eigen::Vector3d> truth{};      ///< empty or one per keyframe
  std::vector<std::vector<Eigen::Vector3d>> lost{};  ///< stretches over which scans were lost, frame by frame
  bool loaded = false;                               ///< from a map that was saved before
  Index frame = 0;                                   ///< number of the session in whose frame it lies
  /// Where its frame is drawn: frames that no merge joined lie side by side.
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();
};

/// An accepted closure. Keyframes are numbered through all sessions, in their order.
struct ReportClosure {
  Index from = 0;
  Index to = 0;
  ClosureKind kind = ClosureKind::direct;
  double score = 0.0;  ///< mean squared error over inliers, m^2
};

/// How many candidates of a kind were refused for one reason.
struct ReportRefusal {
  std::string reason{};
  Index count = 0;
  ClosureKind kind = ClosureKind::direct;
};

/// Keyframes that accepted closures connect, two or more.
struct ReportComponent {
  std::vector<Index> keyframes{};  ///< ascending
  std::vector<Index> sessions{};   ///< numbers of those that it joins, ascending
  Index closures = 0;
};

struct ReportSeries {
  std::string name{};
  std::vector<double> x{};
  std::vector<double> y{};
  Index color = -1;  ///< number of the session whose colour it takes; negative: that of its place in the plot
  bool dashed = false;
};

/// A line plot. Labels carry their unit: "time (s)".
struct ReportPlot {
  std::string title{};
  std::string x_label{};
  std::string y_label{};
  std::vector<ReportSeries> series{};
};

/// A table of the caller's own; the first column names the row.
struct ReportTable {
  std::string title{};
  std::vector<std::string> heads{};
  std::vector<std::vector<std::string>> rows{};
};

/// All that a report shows. What is empty is left out of it.
struct ReportData {
  std::string title{};     ///< what was mapped
  std::string subtitle{};  ///< a sentence below it
  std::string verdict{};   ///< the first line: whether the map is what was asked for
  bool failed = false;     ///< it is not
  std::vector<std::pair<std::string, std::string>> answers{};  ///< below it: what is asked first, and the answer
  std::string folder{};                                        ///< of the report and its `files`
  std::vector<ReportFile> files{};
  std::vector<ReportFigure> figures{};
  std::vector<std::pair<std::string, std::string>> summary{};  ///< rows of a table: what, and how much
  std::vector<ReportTable> tables{};
  std::vector<std::string> warnings{};
  std::vector<ReportSession> sessions{};
  std::vector<ReportClosure> closures{};
  std::vector<ReportRefusal> refusals{};
  std::vector<ReportComponent> components{};                ///< of the adjacency graph, the largest first
  std::vector<Eigen::Vector3f> points{};                    ///< the map, metres, near `points_origin`
  std::vector<std::uint8_t> point_sessions{};               ///< number of each point's session; empty or one per point
  Eigen::Vector3d points_origin = Eigen::Vector3d::Zero();  ///< added to each point: keeps floats small far from zero
  std::vector<ReportPlot> plots{};
  std::vector<StageTime> stages{};
};

/// Sessions, closures, refusals, components and points of a map.
///
/// Frames that no merge joined are moved apart, since nothing is known of how they lie to each other.
/// @param voxel_size  edge of the cells in which one point of each session is kept, metres; larger where more than two
/// million points would be left.
[[nodiscard]] ReportData report_data(const SlamMap& map, double voxel_size);

/// Where a session's odometry lies without the closures: at the partner of the merge that brought it into its frame, or
/// at its own first keyframe if none did. @returns T_map_odom.
[[nodiscard]] SE3d odometry_placement(const SlamMap& map, const Session& session);

/// The connected components of the adjacency graph, whose nodes are keyframes and whose edges are the closures that
/// are factors; the largest first, the earlier of equals. Keyframes without a closure are left out.
[[nodiscard]] std::vector<ReportComponent> adjacency_components(const SlamMap& map);

/// Speed between keyframes over time, a line for each session that states times.
[[nodiscard]] ReportPlot speed_plot(const std::vector<ReportSession>& sessions);

/// Share of each scan's points with a match in the local map over time, a line for each session that has frames.
[[nodiscard]] ReportPlot match_plot(const SlamMap& map);

/// Distance from the truth over time, of each session that has truth and times. One session: optimized and odometry
/// alone. Several: the optimized ones together, then one plot for each as if it were the only one.
[[nodiscard]] std::vector<ReportPlot> error_plots(const std::vector<ReportSession>& sessions);

/// What the back end took for each keyframe.
[[nodiscard]] ReportPlot back_end_plot(const std::vector<double>& keyframe_seconds);

inline constexpr std::array closure_kinds{ClosureKind::direct, ClosureKind::chained, ClosureKind::merge};

/// A verdict in words: "high residual".
[[nodiscard]] std::string name_of(ClosureVerdict verdict);

/// A kind in words: "direct", "chained", "merge".
[[nodiscard]] std::string name_of(ClosureKind kind);

}  // namespace chainslam::support
