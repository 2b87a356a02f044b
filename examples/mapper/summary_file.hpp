#pragma once

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

namespace chainslam::mapper {

/// The figures of a run's summary.json in the order of the file: name, with the names of its levels joined by dots, and
/// value, to six digits. A list of objects, such as the sessions, is a table: a line for each figure, a column for each
/// object. @throws IoError if it is no JSON, or nested deeper than summaries are.
[[nodiscard]] std::vector<std::pair<std::string, std::string>> read_summary(const std::filesystem::path& path);

/// The summary as it is, JSON with a line for each figure. @throws IoError as `read_summary`.
[[nodiscard]] std::string read_summary_text(const std::filesystem::path& path);

}  // namespace chainslam::mapper
