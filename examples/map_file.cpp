// A map file: written while the map grows, read back, and recovered after the process that wrote it died.
// Usage: example_map_file [MAP.cslam [RECOVERED.cslam]]: reads a map, intact or not, and writes what could be read.
// Without arguments it works on files in a temporary folder. Link chainslam::archive.
#include <chainslam/io/map_archive.hpp>
#include <chainslam/io/map_journal.hpp>
#include <cstdio>
#include <filesystem>

#include "generated/growing_map.hpp"

using namespace chainslam;
namespace fs = std::filesystem;

void print(const char* what, const LoadedMap& loaded) {
  std::printf("%-10s %zu keyframes, %zu measurements, %s, %llu bytes, %d keyframes lost\n", what,
              loaded.map.keyframes.size(), loaded.map.odometry.size(),
              loaded.report.complete ? "complete" : "incomplete",
              static_cast<unsigned long long>(loaded.report.file_bytes), loaded.report.keyframes_lost);
  for (const std::string& problem : loaded.report.problems) std::printf("           %s\n", problem.c_str());
}

int main(int count, char** arguments) try {
  if (count > 1) {
    const LoadedMap loaded = load_map(arguments[1], {.recover = true});
    print("read", loaded);
    if (count > 2) save_map(arguments[2], loaded);
    return loaded.report.complete ? 0 : 1;
  }
  const fs::path folder = fs::temp_directory_path() / "chainslam_example_map_file";
  fs::remove_all(folder);
  fs::create_directories(folder);
  SlamMap map;
  Rng rng(1);
  {
    MapJournal journal(folder / "map.cslam", {.parameters = "made by example_map_file"});
    for (int i = 0; i < 10; ++i) {
      generated::grow(map, rng);
      journal.update(map);  // from here on a crash does not lose this keyframe
      if (i == 5) fs::copy_file(journal.partial_path(), folder / "crashed.cslam");  // what a crash would have left
    }
    journal.finish(map);
  }
  print("written", load_map(folder / "map.cslam"));
  fs::resize_file(folder / "crashed.cslam", fs::file_size(folder / "crashed.cslam") - 100);  // its last commit is torn
  try {
    (void)load_map(folder / "crashed.cslam");
  } catch (const IoError& refused) {
    std::printf("refused    %s\n", refused.what());
  }
  const LoadedMap recovered = load_map(folder / "crashed.cslam", {.recover = true});
  print("recovered", recovered);
  save_map(folder / "recovered.cslam", recovered);
  print("saved", load_map(folder / "recovered.cslam"));
  fs::remove_all(folder);
} catch (const std::exception& failure) {
  return std::fprintf(stderr, "%s\n", failure.what()), 2;
}
