#pragma once

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <system_error>

namespace chainslam::detail {

/// What to do where a map's file that is in use cannot be read any more.
inline constexpr const char* changed_file_remedy =
    "check the disk, and that nothing else writes the file; `chainslam recover` recovers its intact part in a new file";

/// Opens a file to be read, again as long as a signal interrupts it, as happens on network file systems.
/// @returns its descriptor; negative, with errno, if it cannot be opened.
[[nodiscard]] inline int open_to_read(const std::filesystem::path& path) {
  int file = -1;
  do file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  while (file < 0 && errno == EINTR);
  return file;
}

/// Fills `bytes` with what a file has from `offset` on.
/// @returns what kept it from that; nothing if all were read.
[[nodiscard]] inline std::optional<std::string> read_at(int file, std::uint64_t offset, std::span<std::byte> bytes) {
  while (!bytes.empty()) {
    const ssize_t count = ::pread(file, bytes.data(), bytes.size(), static_cast<off_t>(offset));
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) return std::generic_category().message(errno);
    if (count == 0) return "the end of the file, which was longer before";
    offset += static_cast<std::uint64_t>(count);
    bytes = bytes.subspan(static_cast<std::size_t>(count));
  }
  return std::nullopt;
}

}  // namespace chainslam::detail
