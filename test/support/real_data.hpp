#pragma once

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <string>

namespace chainslam::test {

/// A file or folder of real data, or nothing (and a printed line, which test/run.sh counts) when it is not at hand.
/// test/run.sh unpacks the data and sets CHAINSLAM_UNPACKED_DATA.
inline std::optional<std::filesystem::path> real_data(const std::string& relative) {
  const char* root = std::getenv("CHAINSLAM_UNPACKED_DATA");
  if (root != nullptr && *root != '\0') {
    const std::filesystem::path path = std::filesystem::path(root) / relative;
    if (std::filesystem::exists(path)) return path;
  }
  std::printf("SKIPPED (no data): %s\n", relative.c_str());
  return std::nullopt;
}

}  // namespace chainslam::test
