#pragma once

#include <CLI/CLI.hpp>

namespace chainslam::mapper {

/// Each registers one verb of the program; its callback sets `exit_code` (see exit_code.hpp) or throws.
/// @{
CLI::App* add_map(CLI::App& program, int& exit_code);
CLI::App* add_simulate(CLI::App& program, int& exit_code);
CLI::App* add_inspect(CLI::App& program, int& exit_code);
CLI::App* add_check(CLI::App& program, int& exit_code);
CLI::App* add_recover(CLI::App& program, int& exit_code);
CLI::App* add_export(CLI::App& program, int& exit_code);
CLI::App* add_eval(CLI::App& program, int& exit_code);
CLI::App* add_optimize(CLI::App& program, int& exit_code);
CLI::App* add_config(CLI::App& program, int& exit_code);
/// @}

}  // namespace chainslam::mapper
