#pragma once

#include <fcntl.h>

#include <cerrno>
#include <filesystem>

namespace chainslam::detail {

/// Opens a file to be read, again as long as a signal interrupts it, as happens on network file systems.
/// @returns its descriptor; negative, with errno, if it cannot be opened.
[[nodiscard]] inline int open_to_read(const std::filesystem::path& path) {
  int file = -1;
  do file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  while (file < 0 && errno == EINTR);
  return file;
}

}  // namespace chainslam::detail
