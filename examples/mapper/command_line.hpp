#pragma once

#include "session_workers.hpp"

namespace chainslam::mapper {

/// Reads the command line and runs the verb that it names; help, and what is wrong with the line, is printed.
/// @returns what the program is to tell the shell. @throws what the verb throws.
/// @param workers  as in `run_program`.
int run_command_line(int argc, const char* const* argv, SessionWorkers* workers = nullptr);

}  // namespace chainslam::mapper
