#include "map_file.hpp"

#include <unistd.h>

#include <algorithm>
#include <cstdint>
#include <fstream>
#include <string_view>
#include <system_error>

#include "chainslam/core/error.hpp"
#include "chainslam/io/detail/input_stream.hpp"
#include "chainslam/io/map_archive.hpp"
#include "map_export.hpp"
#include "support/report_data.hpp"
#include "unfinished_run.hpp"

namespace chainslam::mapper {

namespace fs = std::filesystem;

namespace {

std::string how_many(std::uint64_t count, const char* what) {
  return std::to_string(count) + ' ' + what + (count == 1 ? "" : "s");
}

}  // namespace

bool is_map_file(const fs::path& path) {
  constexpr std::string_view mark =
      "\x89"
      "CSLAM\r\n";
  if (!fs::is_regular_file(path)) return false;
  std::string begin(mark.size(), '\0');
  auto file = detail::input_stream(path);
  return file.read(begin.data(), static_cast<std::streamsize>(begin.size())) && begin == mark;
}

fs::path map_path(const fs::path& given) { return fs::is_directory(given) ? given / map_name : given; }

std::uint64_t machine_memory() {
  const long pages = ::sysconf(_SC_PHYS_PAGES), page_bytes = ::sysconf(_SC_PAGESIZE);
  std::uint64_t bytes = pages > 0 && page_bytes > 0
                            ? static_cast<std::uint64_t>(pages) * static_cast<std::uint64_t>(page_bytes)
                            : std::uint64_t{1} << 40;
  for (const char* group : {"/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes"}) {
    std::ifstream file(group);
    if (std::uint64_t allowed = 0; file >> allowed) bytes = std::min(bytes, allowed);
  }
  return bytes;
}

std::uint64_t memory_bound(std::uint64_t given) { return given > 0 ? given : machine_memory() / 2; }

LoadedMap open_map(const fs::path& path, MapLoadOptions options) {
  if (options.max_memory == 0) options.max_memory = machine_memory() / 5 * 4;
  if (!options.scan_cache) options.scan_cache = std::make_shared<ScanCache>();
  return load_map(path, options);
}

std::vector<std::string> losses(const LoadedMap& loaded) {
  const MapFileReport& report = loaded.report;
  std::vector<std::string> lines = report.problems;
  const std::uint64_t keyframes = loaded.map.keyframes.size();
  if (report.keyframes_lost > 0)
    lines.push_back(std::to_string(keyframes) + " of " +
                    how_many(keyframes + static_cast<std::uint64_t>(report.keyframes_lost), "keyframe") + " are there");
  if (!report.scans_lost.empty()) {
    std::string line = "scans lost: keyframes";
    const std::size_t shown = std::min<std::size_t>(report.scans_lost.size(), 20);
    for (std::size_t i = 0; i < shown; ++i) line += ' ' + std::to_string(report.scans_lost[i].value);
    if (shown < report.scans_lost.size()) line += " and " + std::to_string(report.scans_lost.size() - shown) + " more";
    lines.push_back(line);
  }
  if (report.poses_by_odometry > 0)
    lines.push_back(how_many(static_cast<std::uint64_t>(report.poses_by_odometry), "pose") +
                    " after the last optimized ones, placed by odometry");
  if (report.ignored_bytes > 0)
    lines.push_back(how_many(report.ignored_bytes, "byte") + " after byte " +
                    std::to_string(report.file_bytes - report.ignored_bytes) + " ignored");
  return lines;
}

std::string short_account(const SlamMap& map) {
  std::uint64_t scans = 0, points = 0;
  for (const Keyframe& keyframe : map.keyframes)
    if (keyframe.cloud) {
      ++scans;
      points += keyframe.cloud.size();
    }
  return how_many(map.sessions.size(), "session") + ", " + how_many(map.keyframes.size(), "keyframe") + ", " +
         how_many(scans, "scan") + " of " + how_many(points, "point") + ", " + how_many(map.closures.size(), "closure");
}

std::string sessions_account(const SlamMap& map) {
  const std::vector<FrameGroup> groups = frames_of(map);
  std::string text = std::to_string(map.sessions.size()) + " in " + how_many(groups.size(), "frame");
  for (std::size_t i = 0; groups.size() > 1 && i < groups.size(); ++i) {
    std::string names;
    for (const SessionId id : groups[i].sessions) names += (names.empty() ? "" : ", ") + std::to_string(id.value);
    text += (i == 0 ? ": " : " | ") + names;
  }
  return text;
}

std::string closures_account(const SlamMap& map) {
  std::string text;
  for (const ClosureKind kind : support::closure_kinds)
    text += (text.empty() ? "" : ", ") + std::to_string(std::ranges::count(map.closures, kind, &LoopClosure::kind)) +
            " " + support::name_of(kind);
  return text;
}

std::vector<std::string> replay_notes(const LoadedMap& loaded) {
  std::vector<std::string> notes;
  const bool untold = std::ranges::any_of(loaded.map.keyframes, [](const Keyframe& keyframe) {
    return keyframe.gnss && !keyframe.gnss_arrival.after.valid();
  });
  if (untold && loaded.report.format_minor < 4)
    notes.emplace_back(
        "a map of format 1.3 or before does not say when GNSS fixes came: they are given with their keyframes, so "
        "merges may come about earlier than in the run");
  return notes;
}

}  // namespace chainslam::mapper
