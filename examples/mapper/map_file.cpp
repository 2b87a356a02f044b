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

}  // namespace chainslam::mapper
