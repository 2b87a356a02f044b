#pragma once

namespace chainslam::mapper {

/// Reads the command line and runs the verb that it names; help, and what is wrong with the line, is printed.
/// @returns what the program is to tell the shell. @throws what the verb throws.
int run_command_line(int argc, const char* const* argv);

}  // namespace chainslam::mapper
