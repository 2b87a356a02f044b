#pragma once

#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "chainslam/slam/slam_map.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

/// The files that a run of `chainslam map` leaves when it is killed.
struct UnfinishedRun {
  std::filesystem::path inputs;  ///< what the back end was given; empty if there is no such file
  std::filesystem::path map;     ///< what it had made of that so far
};

/// Names in a run's folder.
/// @{
constexpr const char* map_name = "map.cslam";
constexpr const char* inputs_name = "input.cslam";
/// @}

/// What to recover where the user points to: a folder, one of the files in it, or any map file.
[[nodiscard]] UnfinishedRun find_unfinished(const std::filesystem::path& path);

/// Whether there is a keyframe in the map that a run had made so far.
[[nodiscard]] bool has_closed_any(const UnfinishedRun& run);

/// A run's work, done again into a new map file.
struct RepeatedRun {
  std::shared_ptr<const SlamMap> map;
  std::string account;             ///< what was read, a line for the user
  std::vector<std::string> notes;  ///< where the run's configuration is none of this version, what became of it
};

/// Does the back end's work of a run again and saves its map as `arguments.out`. Of a run that another version of the
/// program began, settings that this version does not have are left out, and those that it lacks have their defaults.
/// @returns nothing if the inputs hold less than the run's map: it is then better to take that.
/// @throws IoError if the inputs, or a map that the run had loaded, cannot be read, or the map cannot be written.
[[nodiscard]] std::optional<RepeatedRun> repeat(const UnfinishedRun& run, const RecoverArguments& arguments);

}  // namespace chainslam::mapper
