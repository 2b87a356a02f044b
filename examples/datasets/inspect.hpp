#pragma once

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "datasets/dataset.hpp"

namespace chainslam::datasets {

/// What was found at a path: facts in the order to read them, then what looks wrong.
struct Inspection {
  std::string kind;
  std::vector<std::pair<std::string, std::string>> facts;
  std::vector<std::string> warnings;
};

/// Reads a data set or a single file (PCD, PLY, a trajectory as TUM, KITTI or EuRoC's CSV, a g2o graph) from its start
/// to its end and says what is in it.
/// @throws IoError if it is of no known kind or cannot be read.
[[nodiscard]] Inspection inspect(const std::filesystem::path& path, const DatasetOptions& options = {});

/// As a table for people: a line for each fact, then the warnings.
[[nodiscard]] std::string to_text(const Inspection& inspection);

}  // namespace chainslam::datasets
