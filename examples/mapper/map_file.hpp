#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "chainslam/io/loaded_map.hpp"

namespace chainslam::mapper {

/// Whether a path is a file that begins as map files do.
[[nodiscard]] bool is_map_file(const std::filesystem::path& path);

/// The map file that a user points to: the one in a folder that `chainslam map` wrote, else the path itself.
[[nodiscard]] std::filesystem::path map_path(const std::filesystem::path& given);

/// Bytes of the machine's memory, or of what its control group allows.
[[nodiscard]] std::uint64_t machine_memory();

/// Bytes that a run may take: those given, or half of `machine_memory` for 0.
[[nodiscard]] std::uint64_t memory_bound(std::uint64_t given);

/// `load_map`, unless the options say otherwise within four fifths of `machine_memory`. @throws IoError
[[nodiscard]] LoadedMap open_map(const std::filesystem::path& path, MapLoadOptions options = {});

/// What was lost and damaged in a file, a line each; empty if it is whole.
[[nodiscard]] std::vector<std::string> losses(const LoadedMap& loaded);

/// "1 session, 20 keyframes, ..."
[[nodiscard]] std::string short_account(const SlamMap& map);

/// "2 in 1 frame", "3 in 2 frames: 0, 2 | 1"
[[nodiscard]] std::string sessions_account(const SlamMap& map);

/// "117 direct, 55 chained, 2 merge"
[[nodiscard]] std::string closures_account(const SlamMap& map);

/// What the user should know where sessions of a map are given to a back end again.
[[nodiscard]] std::vector<std::string> replay_notes(const LoadedMap& loaded);

}  // namespace chainslam::mapper
