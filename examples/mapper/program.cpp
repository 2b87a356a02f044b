#include "program.hpp"

#include <fcntl.h>
#include <unistd.h>
#ifdef __GLIBC__
#include <malloc.h>
#endif

#include <cerrno>
#include <csignal>
#include <cstdio>
#include <exception>
#include <new>
#include <string>
#include <system_error>

#include "chainslam/core/error.hpp"
#include "command_line.hpp"
#include "exit_code.hpp"
#include "support/configuration.hpp"

namespace chainslam::mapper {

namespace {

int report(const char* message, int code) {
  std::fprintf(stderr, "error: %s\n", printable(message, true).c_str());
  return code;
}

int run(int argc, char** argv, SessionWorkers* workers) {
  try {
    return run_command_line(argc, argv, workers);
  } catch (const support::ConfigError& error) {
    return report(error.what(), exit_usage);
  } catch (const IoError& error) {
    return report(error.what(), error.kind() == IoError::Kind::input ? exit_input : exit_output);
  } catch (const std::bad_alloc&) {
    return report(
        "out of memory\n  found: an allocation failed\n  do: give the machine more memory, or raise the voxel sizes",
        exit_internal);
  } catch (const std::exception& error) {
    const std::string text = error.what();
    return report((text + "\n  found: a fault of the program's own\n  do: report it with the command and its output; "
                          "what a run of `chainslam map` had read stays for `chainslam recover`")
                      .c_str(),
                  exit_internal);
  }
}

/// Where the shell has closed one of the standard streams, the next file would take its number, and what is printed
/// would go there.
void open_standard_streams() {
  for (;;) {
    const int file = ::open("/dev/null", O_RDWR);
    if (file > STDERR_FILENO) {
      ::close(file);
      return;
    }
    if (file < 0) return;
  }
}

/// Blocks from 1 MiB on go back to the system when they are freed. Those of submaps, which caches let go in any
/// order, otherwise leave holes that take a fifth of a long run's memory. The end of the heap stays: to return it and
/// to ask for it again, page by page, at each alignment would take a tenth of the back end's time.
void set_memory_policy() {
#ifdef __GLIBC__
  ::mallopt(M_MMAP_THRESHOLD, 1 << 20);
  ::mallopt(M_TRIM_THRESHOLD, 512 << 20);
#endif
}

/// What was printed may never have come to where it was to go, as on a full disk. A reader that has left, as `head`
/// does, wants no more.
int checked(int exit_code) {
  errno = 0;
  const bool failed = std::fflush(stdout) != 0 || std::ferror(stdout) != 0;
  if (!failed || errno == EPIPE || exit_code != exit_good) return exit_code;
  return report(("standard output\n  found: " + std::generic_category().message(errno) +
                 "\n  do: free space where the output goes; files that were named by options are complete")
                    .c_str(),
                exit_output);
}

}  // namespace

int run_program(int argc, char** argv, SessionWorkers* workers) {
  // A limit on file sizes and a closed pipe then are errors like any other: reported, with everything else saved.
  open_standard_streams();
  set_memory_policy();
  std::signal(SIGXFSZ, SIG_IGN);
  std::signal(SIGPIPE, SIG_IGN);
  return checked(run(argc, argv, workers));
}

}  // namespace chainslam::mapper
