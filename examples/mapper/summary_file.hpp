#pragma once

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

namespace chainslam::mapper {

/// The figures of a run's summary.json in the order of the file: name, with the names of its levels joined by dots, and
/// value. @throws IoError if it is no JSON, or nested deeper than summaries are.
[[nodiscard]] std::vector<std::pair<std::string, std::string>> read_summary(const std::filesystem::path& path);

}  // namespace chainslam::mapper
