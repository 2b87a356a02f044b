#include <cstdio>
#include <exception>
#include <new>
#include <stdexcept>

#include "chainslam/core/error.hpp"
#include "chainslam/core/printable.hpp"
#include "command_line.hpp"
#include "exit_code.hpp"
#include "support/configuration.hpp"

namespace {

using namespace chainslam;
using namespace chainslam::mapper;

int report(const char* message, int code) {
  std::fprintf(stderr, "error: %s\n", printable(message, true).c_str());
  return code;
}

int run(int argc, char** argv) {
  try {
    return run_command_line(argc, argv);
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
