#pragma once

#include <filesystem>

#include "results.hpp"
#include "support/report_data.hpp"

namespace chainslam::mapper {

/// Adds what a reader of the report asks first: whether the sessions are merged, the error, what was lost or is
/// doubtful.
void add_answers(const RunOutcome& outcome, support::ReportData& data);

/// Adds the results that stand in `written`, as links.
/// @param folder  where they are when the run is over.
void add_files(const std::filesystem::path& written, const std::filesystem::path& folder, support::ReportData& data);

}  // namespace chainslam::mapper
