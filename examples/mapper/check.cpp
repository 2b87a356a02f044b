#include <cstdio>
#include <filesystem>
#include <memory>

#include "exit_code.hpp"
#include "map_file.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

namespace {

int run(const std::filesystem::path& path) {
  const LoadedMap loaded = open_map(path, {.recover = true});
  const MapFileReport& report = loaded.report;
  if (report.complete) {
    std::printf("%s: whole, format %d.%d\n  %s\n", path.c_str(), report.format_major, report.format_minor,
                short_account(loaded.map).c_str());
    if (report.unknown_chunks > 0)
      std::printf("  %d parts of a newer version, unknown to this one\n", report.unknown_chunks);
    return exit_good;
  }
  std::fprintf(stderr, "error: %s: not whole\n", path.c_str());
  for (const std::string& line : losses(loaded)) std::fprintf(stderr, "  found: %s\n", line.c_str());
  std::fprintf(stderr, "  do: `chainslam recover` saves what is left in a new file: %s\n",
               short_account(loaded.map).c_str());
  return exit_input;
}

}  // namespace

CLI::App* add_check(CLI::App& program, int& exit_code) {
  const auto path = std::make_shared<std::filesystem::path>();
  CLI::App* verb = program.add_subcommand("check", "check every checksum and every rule of a map file");
  verb->footer("Reads all of it. Exit code 3 if anything is damaged or missing, with an account of what is left.");
  verb->add_option("MAP", *path, "map file (.cslam)")->required()->option_text(" ");
  verb->callback([path, &exit_code] { exit_code = run(*path); });
  return verb;
}

}  // namespace chainslam::mapper
