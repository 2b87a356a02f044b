#pragma once

#include <string>

namespace chainslam::mapper {

/// What the program is and how it was built, as `--version` prints it: the version, then a line each for compiler,
/// configuration, instruction set and libraries.
[[nodiscard]] std::string build_description();

}  // namespace chainslam::mapper
