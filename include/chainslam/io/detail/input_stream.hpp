#pragma once

#include <cerrno>
#include <filesystem>
#include <fstream>

namespace chainslam::detail {

/// A stream that reads a file; it is opened again as long as a signal interrupts that.
[[nodiscard]] inline std::ifstream input_stream(const std::filesystem::path& path) {
  std::ifstream stream;
  do {
    errno = 0;
    stream.open(path, std::ios::binary);
  } while (!stream.is_open() && errno == EINTR);
  return stream;
}

}  // namespace chainslam::detail
