#include "datasets/ros_recording.hpp"

#include <array>
#include <string>
#include <utility>

#include "chainslam/core/error.hpp"
#include "datasets/files.hpp"

namespace chainslam::datasets {
namespace {

using Opener = std::unique_ptr<RosRecording> (*)(const std::filesystem::path&);

constexpr std::array<std::pair<std::string_view, Opener>, 3> recording_kinds{
    {{".bag", open_ros1_bag}, {".mcap", open_mcap}, {".db3", open_db3}}};

}  // namespace

std::vector<std::filesystem::path> recording_files(const std::filesystem::path& path) {
  for (const auto& [extension, opener] : recording_kinds) {
    if (path.extension() == extension && std::filesystem::is_regular_file(path)) return {path};
    auto files = files_in(path, {extension});
    if (!files.empty()) return files;
  }
  return {};
}

std::unique_ptr<RosRecording> open_recording(const std::filesystem::path& file) {
  for (const auto& [extension, opener] : recording_kinds)
    if (file.extension() == extension) return opener(file);
  throw_input_error(file.string(), "", "a file of no known kind of recording", "name a .bag, .mcap or .db3");
}

}  // namespace chainslam::datasets
