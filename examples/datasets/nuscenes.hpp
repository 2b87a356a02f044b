#pragma once

#include <filesystem>

namespace chainslam::datasets {

/// The folder of a nuScenes object's tables: the one in `path` whose name begins with v1.0 and that holds scene.json
/// and sample_data.json. `path` may name one of the object's scenes, as if it were a folder in it. Empty if there is
/// none.
[[nodiscard]] std::filesystem::path nuscenes_tables(const std::filesystem::path& path);

}  // namespace chainslam::datasets
