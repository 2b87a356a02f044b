#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <string>

#include "chainslam/core/finite.hpp"
#include "support/report_data.hpp"

namespace chainslam::support {

/// Whether a number can be drawn: finite, and so small that differences, squares and float copies are finite as well.
/// 1e15 m is also where doubles begin to be coarser than a pixel.
[[nodiscard]] inline bool is_drawable(double value) { return is_finite(value) && std::abs(value) < 1e15; }
[[nodiscard]] inline bool is_drawable(const Eigen::Vector3d& p) {
  return is_drawable(p.x()) && is_drawable(p.y()) && is_drawable(p.z());
}

/// A number with so many decimals, or a dash if it is not finite.
[[nodiscard]] std::string fixed(double value, int decimals);

/// Class that gives an element the colour of a session.
[[nodiscard]] std::string session_class(std::size_t session);

/// An entry of a legend: a line in the colour and style of `swatch`'s classes, and what it stands for.
[[nodiscard]] std::string legend_entry(const std::string& swatch, const std::string& label);

[[nodiscard]] Index count_kind(const ReportData& data, ClosureKind kind);
[[nodiscard]] bool has_odometry(const ReportData& data);
[[nodiscard]] bool has_truth(const ReportData& data);
[[nodiscard]] bool has_lost(const ReportData& data);

/// The sections of the page that show the map from above: as it is, with components and a legend that switches layers
/// on and off, and before and after the closures.
[[nodiscard]] std::string plan_section(const ReportData& data);
[[nodiscard]] std::string before_after_section(const ReportData& data);

/// The section with all tables.
[[nodiscard]] std::string tables_section(const ReportData& data);

}  // namespace chainslam::support
