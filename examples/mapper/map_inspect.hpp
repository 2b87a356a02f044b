#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>

#include "chainslam/slam/slam_map.hpp"
#include "datasets/inspect.hpp"

namespace chainslam::mapper {

/// What a map file says, without reading its scans. @throws IoError if nothing of it can be read.
[[nodiscard]] datasets::Inspection inspect_map_file(const std::filesystem::path& path);

/// Prints the closures of a map, accepted and refused, as a table: why each was tried, and what became of it.
void print_closures(const SlamMap& map);

/// The same for programs, with the measured poses: an array of objects.
[[nodiscard]] nlohmann::ordered_json closures_json(const SlamMap& map);

}  // namespace chainslam::mapper
