#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "chainslam/io/loaded_map.hpp"

namespace chainslam::mapper {

/// Whether a path is a file that begins as map files do.
[[nodiscard]] bool is_map_file(const std::filesystem::path& path);

/// Bytes that a map may take: four fifths of the machine's memory, or of what its control group allows.
[[nodiscard]] std::uint64_t memory_limit();

/// `load_map` within `memory_limit`. @throws IoError
[[nodiscard]] LoadedMap open_map(const std::filesystem::path& path, MapLoadOptions options = {});

/// What was lost and damaged in a file, a line each; empty if it is whole.
[[nodiscard]] std::vector<std::string> losses(const LoadedMap& loaded);

/// "1 session, 20 keyframes, ..."
[[nodiscard]] std::string short_account(const SlamMap& map);

/// Renames what stands at `path` to the first free of PATH~1, PATH~2, ...; does nothing if nothing does.
/// @throws IoError if something does and `overwrite` is false.
void make_room(const std::filesystem::path& path, bool overwrite);

}  // namespace chainslam::mapper
