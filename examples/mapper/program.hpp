#pragma once

#include "session_workers.hpp"

namespace chainslam::mapper {

/// Runs the program as its `main`: prepares streams, memory and signals, runs the command line and reports what was
/// thrown. @returns what the program is to tell the shell.
/// @param workers  compute the odometry of `map`'s sessions; none: the run itself.
int run_program(int argc, char** argv, SessionWorkers* workers = nullptr);

}  // namespace chainslam::mapper
