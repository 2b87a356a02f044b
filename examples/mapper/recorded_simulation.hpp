#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "datasets/dataset.hpp"
#include "simulator/recorded_files.hpp"
#include "verbs.hpp"

namespace chainslam::mapper {

/// A semi-real drive, and what is said about it.
struct RecordedSimulation {
  std::unique_ptr<simulator::RecordedDrive> drive;
  simulator::RecordedTexts texts;
  std::string agreement;  ///< lines on how well recorded IMU data and the ground suit the trajectory; may be empty
};

/// Reads what the arguments name and builds the world.
/// @throws IoError, support::ConfigError or std::invalid_argument that say what is wrong with it.
[[nodiscard]] RecordedSimulation make_recorded_simulation(const SimulateArguments& arguments);

/// A semi-real drive, by the folder that `simulate --trajectory` has written, with or without scans: they are made
/// again while they are read, the same to the last bit.
/// @returns nothing if it is no such folder.
[[nodiscard]] std::unique_ptr<datasets::Dataset> open_recorded_simulation(const std::filesystem::path& folder);

}  // namespace chainslam::mapper
