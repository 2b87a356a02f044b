#pragma once

#include <CLI/CLI.hpp>
#include <filesystem>
#include <string>
#include <tuple>
#include <vector>

#include "table_file.hpp"

namespace chainslam::experiments {

/// A session of a map.
struct MapSession {
  std::filesystem::path recording;   ///< what `chainslam odometry` wrote
  std::filesystem::path trajectory;  ///< T_map_body, as TUM's
  int frame = 0;                     ///< number of the map's frame that it lies in
};

/// What programs get that read a map's trajectories and its recordings.
struct SessionArguments {
  std::vector<MapSession> sessions;
  int threads = 1;
};

/// The main function of such a program: reads the command line, and writes the file that it names.
/// @param text  `std::string text(const SessionArguments&)`: what to write. @returns the exit code.
template <class Text>
int run_on_sessions(int count, char** words, const char* program, const char* description, const Text& text) {
  std::vector<std::tuple<std::string, std::string, int>> sessions;
  std::filesystem::path out;
  SessionArguments arguments;
  CLI::App app(description);
  app.add_option("--session", sessions, "recording, its trajectory in the map, number of the frame it lies in")
      ->required()
      ->option_text("SET FILE FRAME");
  app.add_option("--out", out, "JSON file to write")->required();
  app.add_option("--threads", arguments.threads, "changes the time, not the result")->check(CLI::Range(1, 1024));
  CLI11_PARSE(app, count, words);
  for (const auto& [recording, trajectory, frame] : sessions)
    arguments.sessions.push_back({.recording = recording, .trajectory = trajectory, .frame = frame});
  return bench::write_table(program, out, [&] { return text(arguments); });
}

}  // namespace chainslam::experiments
