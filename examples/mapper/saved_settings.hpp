#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "options.hpp"

namespace chainslam::mapper {

/// The settings that a map or a run's journal states, as far as this version of the program has them.
struct SavedSettings {
  MapperOptions options;
  std::string text;                ///< as a file; what was stated where this version has all of it
  std::vector<std::string> notes;  ///< what this version does not have, and what it has beside
};

/// @param stated     the parameters' text of `file`
/// @param remedy     what to do where this version cannot use it
/// @param overrides  assignments of the command line
/// @throws IoError of kind input for values that this version refuses; support::ConfigError for overrides.
[[nodiscard]] SavedSettings saved_settings(const std::string& stated, const std::filesystem::path& file,
                                           const std::string& remedy, const std::vector<std::string>& overrides = {});

}  // namespace chainslam::mapper
