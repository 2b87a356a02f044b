#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "chainslam/core/timestamp.hpp"

namespace chainslam::datasets {

/// The files of a folder whose extension is one of `extensions` (with the dot, lower case), sorted so that numbers in
/// names count as numbers: 2.pcd comes before 10.pcd. Empty if there is no such folder.
[[nodiscard]] std::vector<std::filesystem::path> files_in(const std::filesystem::path& folder,
                                                          const std::vector<std::string_view>& extensions);

/// One stamp a line: decimal seconds, or `YYYY-MM-DD hh:mm:ss.nnnnnnnnn` (taken as UTC); blank lines are skipped.
/// @param in_order  whether stamps may not go back.
/// @throws IoError naming the line, also of a stamp that is earlier than the one before it, if `in_order`.
[[nodiscard]] std::vector<Timestamp> read_stamps(const std::filesystem::path& path, bool in_order = true);

/// `YYYY-MM-DD hh:mm:ss.nnnnnnnnn` as time since 1970, exactly. Nothing if the text is none.
[[nodiscard]] std::optional<Timestamp> parse_date_time(std::string_view text);

/// A whole number as a time since 1970: nanoseconds or microseconds, by its size. Nothing if it is neither.
[[nodiscard]] std::optional<Timestamp> time_of_whole(std::int64_t value);

/// The time that a file's name states: nanoseconds or microseconds since 1970 (`1583836591182590976`), decimal seconds
/// (`1583836591.182590976`) or `<anything>_<seconds>_<nanoseconds>`. Nothing for mere numbers such as `000042`.
[[nodiscard]] std::optional<Timestamp> time_of_name(const std::string& stem);

/// "a/, b.txt, ... (12 more)": what a folder holds, for messages.
[[nodiscard]] std::string contents_of(const std::filesystem::path& folder);

/// The folder's name, also when the path ends in a slash or is ".".
[[nodiscard]] std::string folder_name(const std::filesystem::path& path);

}  // namespace chainslam::datasets
