#pragma once

#include <cstddef>
#include <filesystem>
#include <string>

#include "support/report_data.hpp"

namespace chainslam::support {

struct ReportOptions {
  std::filesystem::path three_js = "/usr/share/javascript/three/three.min.js";  ///< release 111, as Debian has it
  std::size_t max_points = 350'000;  ///< of the map in the 3-D view; more are thinned evenly in space
};

/// The report as one HTML page that needs nothing else: it opens from disk, asks no network for anything, and its
/// Content-Security-Policy forbids it to. Every name is escaped.
/// @throws IoError if three.js cannot be read; std::invalid_argument if sessions, closures or points do not fit
/// together.
[[nodiscard]] std::string report_html(const ReportData& data, const ReportOptions& options = {});

/// Writes `report_html` to a file that appears whole or not at all. @throws IoError, std::invalid_argument
void write_report(const std::filesystem::path& path, const ReportData& data, const ReportOptions& options = {});

}  // namespace chainslam::support
