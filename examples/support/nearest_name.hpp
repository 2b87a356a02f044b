#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace chainslam::support {

/// The candidate that a mistyped name was probably meant to be, by insertions, deletions, replacements and swaps of
/// neighbours (Damerau 1964); nothing if none is near. Of dotted names, a right last part in the wrong table is near
/// too.
[[nodiscard]] std::optional<std::string> nearest_name(std::string_view name,
                                                      const std::vector<std::string>& candidates);

/// The names of a list for people, which are separated by commas.
[[nodiscard]] std::vector<std::string> names_of_list(std::string_view list);

/// "; did you mean 'NAME'?", or nothing if no candidate is near.
[[nodiscard]] std::string suggestion(std::string_view name, const std::vector<std::string>& candidates);

}  // namespace chainslam::support
