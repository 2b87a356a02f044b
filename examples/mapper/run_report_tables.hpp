#pragma once

#include <string>

#include "chainslam/core/types.hpp"
#include "results.hpp"
#include "support/report_data.hpp"

namespace chainslam::mapper {

/// "0.123 m", "12.3 m".
[[nodiscard]] std::string metres(double value);
/// "1 session", "2 sessions".
[[nodiscard]] std::string counted(Index count, const std::string& thing);

/// Adds a report's tables of a run: what joins sessions, lost and doubtful intervals, the IMU, errors against the
/// truth.
void add_tables(const RunOutcome& outcome, support::ReportData& data);

}  // namespace chainslam::mapper
