#pragma once

#include <cstddef>
#include <string>

#include "support/report_data.hpp"

namespace chainslam::support {

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
