#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"
#include "chainslam/map/slam_map.hpp"
#include "support/statistics.hpp"

namespace chainslam::support {

/// A figure that the report shows large, at its top.
struct ReportFigure {
  std::string label{};  ///< "Chained closures"
  std::string value{};  ///< "118"
  std::string note{};   ///< small, below: "from 41 direct ones"
};

/// One session's keyframes. All positions in the map frame, metres.
struct ReportSession {
  std::string name{};
  std::vector<double> times{};               ///< seconds since the session's start; empty or one per keyframe
  std::vector<Eigen::Vector3d> optimised{};  ///< one per keyframe
  std::vector<Eigen::Vector3d> odometry{};  ///< without closures, laid on the first keyframe; empty or one per keyframe
  std::vector<Eigen::Vector3d> truth{};     ///< empty or one per keyframe
};

/// An accepted closure. Keyframes are numbered through all sessions, in their order.
struct ReportClosure {
  Index from = 0;
  Index to = 0;
  ClosureKind kind = ClosureKind::direct;
  double score = 0.0;  ///< mean squared error over inliers, m^2
};

/// How many candidates were refused for one reason.
struct ReportRefusal {
  std::string reason{};
  Index count = 0;
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

/// All that a report shows. What is empty is left out of it.
struct ReportData {
  std::string title{};     ///< what was mapped
  std::string subtitle{};  ///< a sentence below it
  std::vector<ReportFigure> figures{};
  std::vector<std::pair<std::string, std::string>> summary{};  ///< rows of a table: what, and how much
  std::vector<std::string> warnings{};
  std::vector<ReportSession> sessions{};
  std::vector<ReportClosure> closures{};
  std::vector<ReportRefusal> refusals{};
  std::vector<Eigen::Vector3f> points{};                    ///< the map, metres, near `points_origin`
  std::vector<std::uint8_t> point_sessions{};               ///< number of each point's session; empty or one per point
  Eigen::Vector3d points_origin = Eigen::Vector3d::Zero();  ///< added to each point: keeps floats small far from zero
  std::vector<ReportPlot> plots{};
  std::vector<StageTime> stages{};
};

/// Sessions, closures, refusals and points of a map.
/// @param voxel_size  edge of the cells in which one point of each session is kept, metres.
[[nodiscard]] ReportData report_data(const SlamMap& map, double voxel_size);

/// Speed between keyframes over time, a line for each session that states times.
[[nodiscard]] ReportPlot speed_plot(const std::vector<ReportSession>& sessions);

/// Distance from the truth over time, optimised and odometry alone, for each session that has truth and times.
[[nodiscard]] ReportPlot error_plot(const std::vector<ReportSession>& sessions);

inline constexpr std::array closure_kinds{ClosureKind::direct, ClosureKind::chained, ClosureKind::merge};

/// A verdict in words: "high residual".
[[nodiscard]] std::string name_of(ClosureVerdict verdict);

/// A kind in words: "direct".
[[nodiscard]] std::string name_of(ClosureKind kind);

}  // namespace chainslam::support
