#pragma once

#include <span>
#include <string>
#include <string_view>

#include "simulator/preset.hpp"

namespace chainslam::simulator {

/// One thing that makes real data worse than ideal ones, as a switch: the options of a preset that it stands for.
struct ErrorSource {
  std::string_view name;                         ///< such as "laser-angles"
  std::string_view summary;                      ///< one sentence
  std::string_view reference;                    ///< where its size in the presets `nclt-hard` and `mars-hard` is from
  void (*copy)(Preset& to, const Preset& from);  ///< its options, and no others
};

/// All of them.
[[nodiscard]] std::span<const ErrorSource> error_sources();

/// Their names, as a list for people.
[[nodiscard]] std::string error_source_names();

/// The preset without some of its error sources, or with no others.
/// @param names  separated by commas; "all" is all of them, and nothing none.
/// @throws std::invalid_argument if there is no such error source.
/// @{
[[nodiscard]] Preset without_errors(const Preset& preset, std::string_view names);
[[nodiscard]] Preset with_only_errors(const Preset& preset, std::string_view names);
/// @}

}  // namespace chainslam::simulator
