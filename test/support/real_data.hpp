#pragma once

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <string>

namespace chainslam::test {

/// Where a file or folder of real data would be, if it is there. test/run.sh unpacks the data and sets
/// CHAINSLAM_UNPACKED_DATA.
inline std::optional<std::filesystem::path> find_real_data(const std::string& relative) {
  const char* root = std::getenv("CHAINSLAM_UNPACKED_DATA");
  if (root == nullptr || *root == '\0') return std::nullopt;
  const std::filesystem::path path = std::filesystem::path(root) / relative;
  return std::filesystem::exists(path) ? std::optional(path) : std::nullopt;
}

/// The same for a test that needs it: where it is not at hand, prints a line, which test/run.sh counts.
inline std::optional<std::filesystem::path> real_data(const std::string& relative) {
  const auto path = find_real_data(relative);
  if (!path) std::printf("SKIPPED (no data): %s\n", relative.c_str());
  return path;
}

}  // namespace chainslam::test
