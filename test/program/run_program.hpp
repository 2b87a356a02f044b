#pragma once

#include <sys/wait.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <string>

#include "support/quick.hpp"

namespace chainslam::test {

namespace fs = std::filesystem;

inline std::string read_text(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

inline void write_text(const fs::path& path, const std::string& text) { std::ofstream(path, std::ios::binary) << text; }

inline std::string quoted(const fs::path& path) { return "'" + path.string() + "'"; }

inline bool contains(const std::string& text, const std::string& part) { return text.find(part) != std::string::npos; }

/// An empty folder of its own, removed at the end.
class ScratchFolder {
 public:
  explicit ScratchFolder(const std::string& name)
      : path_(fs::temp_directory_path() / ("chainslam_" + name + "_" + std::to_string(::getpid()))) {
    fs::remove_all(path_);
    fs::create_directories(path_);
  }
  ~ScratchFolder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  ScratchFolder(const ScratchFolder&) = delete;
  ScratchFolder& operator=(const ScratchFolder&) = delete;

  [[nodiscard]] const fs::path& path() const { return path_; }

 private:
  fs::path path_;
};

struct ProgramResult {
  int exit_code = -1;
  std::string output;
  std::string errors;
};

/// Runs `prefix chainslam ARGUMENTS` in a shell; CHAINSLAM_PROGRAM is the built program.
inline ProgramResult run_program(const fs::path& scratch, const std::string& arguments,
                                 const std::string& prefix = "") {
  const fs::path output = scratch / "stdout.txt", errors = scratch / "stderr.txt";
  const std::string command =
      prefix + " '" CHAINSLAM_PROGRAM "' " + arguments + " >'" + output.string() + "' 2>'" + errors.string() + "'";
  const int status = std::system(command.c_str());
  return {WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status), read_text(output), read_text(errors)};
}

inline nlohmann::json summary_of(const fs::path& map) { return nlohmann::json::parse(read_text(map / "summary.json")); }

/// The root mean square of a translational error of `odometry`, `optimized`, ... as a run's summary states it, metres.
inline double rmse(const nlohmann::json& summary, const char* which, const char* metric = "ape") {
  return summary["errors"][which][metric]["translation"]["rmse"].get<double>();
}

}  // namespace chainslam::test
