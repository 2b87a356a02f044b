#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "chainslam/io/loaded_map.hpp"

namespace chainslam::mapper {

/// Whether a path is a file that begins as map files do.
[[nodiscard]] bool is_map_file(const std::filesystem::path& path);

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

}  // namespace chainslam::mapper
