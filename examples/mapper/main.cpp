#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>
#include <new>
#include <stdexcept>

#include "chainslam/core/error.hpp"
#include "chainslam/core/version.hpp"
#include "exit_code.hpp"
#include "support/configuration.hpp"
#include "verbs.hpp"

namespace {

using namespace chainslam;
using namespace chainslam::mapper;

#define CHAINSLAM_TEXT_OF(x) #x
#define CHAINSLAM_TEXT(x) CHAINSLAM_TEXT_OF(x)
constexpr const char* version = CHAINSLAM_TEXT(CHAINSLAM_VERSION_MAJOR) "." CHAINSLAM_TEXT(
    CHAINSLAM_VERSION_MINOR) "." CHAINSLAM_TEXT(CHAINSLAM_VERSION_PATCH);

int report(const char* message, int code) {
  std::fprintf(stderr, "error: %s\n", message);
  return code;
}

int run(int argc, char** argv) {
  CLI::App program{"chainslam: maps from LiDAR sequences, with loop closures and a pose graph", "chainslam"};
  program.set_version_flag("--version", version);
  program.require_subcommand(1);
  program.footer(
      "chainslam VERB --help explains a verb.\n"
      "Exit codes: 0 good, 2 usage or configuration, 3 input unusable, 4 output or disk,\n"
      "5 finished but a stated goal was missed, 70 internal error, 130 interrupted (map saved).");
  int exit_code = exit_good;
  add_map(program, exit_code);
  add_simulate(program, exit_code);
  add_inspect(program, exit_code);
  add_check(program, exit_code);
  add_recover(program, exit_code);
  add_export(program, exit_code);
  add_eval(program, exit_code);
  add_optimize(program, exit_code);
  add_config(program, exit_code);
  try {
    program.parse(argc, argv);
    return exit_code;
  } catch (const CLI::ParseError& error) {
    return program.exit(error) == 0 ? exit_good : exit_usage;
  } catch (const support::ConfigError& error) {
    return report(error.what(), exit_usage);
  } catch (const IoError& error) {
    return report(error.what(), error.kind() == IoError::Kind::input ? exit_input : exit_output);
  } catch (const std::invalid_argument& error) {
    return report(error.what(), exit_usage);
  } catch (const std::bad_alloc&) {
    return report(
        "out of memory\n  found: an allocation failed\n  do: give the machine more memory, or raise the voxel sizes",
        exit_internal);
  } catch (const std::exception& error) {
    return report(error.what(), exit_internal);
  }
}

}  // namespace

int main(int argc, char** argv) { return run(argc, argv); }
