#include <cstdio>
#include <filesystem>
#include <string>

#include "chainslam/core/error.hpp"
#include "exit_code.hpp"
#include "map_file.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

int run(const CheckArguments& arguments) {
  const std::filesystem::path& path = arguments.map;
  const LoadedMap loaded = open_map(path, {.recover = true});
  for (const Keyframe& keyframe : loaded.map.keyframes) static_cast<void>(keyframe.cloud.load());  // one by one
  const MapFileReport& report = loaded.report;
  const std::string name = printable(path.native());
  if (report.complete) {
    std::printf("%s: intact, format %d.%d\n  %s\n", name.c_str(), report.format_major, report.format_minor,
                short_account(loaded.map).c_str());
    if (report.unknown_chunks > 0)
      std::printf("  %d parts of a newer version, unknown to this one\n", report.unknown_chunks);
    return exit_good;
  }
  std::fprintf(stderr, "error: %s: damaged or incomplete\n", name.c_str());
  for (const std::string& line : losses(loaded)) std::fprintf(stderr, "  found: %s\n", printable(line).c_str());
  std::fprintf(stderr, "  do: `chainslam recover` saves what is left in a new file: %s\n",
               short_account(loaded.map).c_str());
  return exit_input;
}

}  // namespace chainslam::mapper
