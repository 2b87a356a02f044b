#pragma once

#include <filesystem>

#include "datasets/inspect.hpp"

namespace chainslam::mapper {

/// What a map file says, without reading its scans. @throws IoError if nothing of it can be read.
[[nodiscard]] datasets::Inspection inspect_map_file(const std::filesystem::path& path);

/// Prints the closures of a map file, accepted and refused, as comma-separated values.
void print_closures_of(const std::filesystem::path& path);

}  // namespace chainslam::mapper
