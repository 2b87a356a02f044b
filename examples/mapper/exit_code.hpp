#pragma once

namespace chainslam::mapper {

/// What the program tells the shell.
enum ExitCode : int {
  exit_good = 0,
  exit_usage = 2,         ///< command line or configuration
  exit_input = 3,         ///< input that cannot be used
  exit_output = 4,        ///< output or disk
  exit_goal_missed = 5,   ///< finished, but a stated goal was missed
  exit_internal = 70,     ///< a fault of the program's own
  exit_interrupted = 130  ///< stopped by Ctrl-C, map saved
};

}  // namespace chainslam::mapper
