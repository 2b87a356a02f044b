#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "support/plot.hpp"
#include "support/report_data.hpp"

namespace chainslam::support {

/// The elements from which a report's script reads what it shows: `meta` (JSON), and in base64 `points` (three uint16
/// each, between the lowest and the highest coordinate), `point-sessions` (uint8), `paths` (three float each) and
/// `closures` (from, to, kind as int32). None of them is run as a script.
/// @param max_points  of the map; more are thinned evenly in space.
[[nodiscard]] std::string view_elements(const ReportData& data, std::size_t max_points,
                                        const std::vector<PlotDrawing>& plots);

}  // namespace chainslam::support
