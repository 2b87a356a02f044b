#include <sys/resource.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <string>
#include <string_view>
#include <thread>

#include "end_on_interrupt.hpp"
#include "exit_code.hpp"
#include "mpi_transport.hpp"
#include "program.hpp"
#include "recorded_sessions.hpp"
#include "session_task.hpp"
#include "tasks/child_executor.hpp"
#include "tasks/coordinator.hpp"
#include "tasks/worker.hpp"

// The program `chainslam` for several machines: process 0 runs the command line, the others compute for it; see
// README.md in this folder.

namespace {

using namespace chainslam;

constexpr std::string_view task_option = "--do-task";  // how this program starts itself

void say(char mark, const std::string& text) {
  std::printf("%c%s\n", mark, text.c_str());
  std::fflush(stdout);
}

/// Records one session in a process of its own; see `tasks::ChildExecutor`.
/// @param share     of the machine's cores
/// @param niceness  where the parent has something else to do
int do_task(const char* share, const char* niceness) {
  tasks::end_with_parent();
  ::setpriority(PRIO_PROCESS, 0, std::stoi(niceness));
  const mapper::EndOnInterrupt end_on_interrupt({}, "");
  try {
    mpi::SessionTask task = mpi::task_of(tasks::read_task());
    if (task.threads == 0) task.threads = std::max(Index{1}, to_index(std::stoul(share)));
    auto shown = std::chrono::steady_clock::now();
    const mpi::SessionResult result = mpi::record_session(task, [&](Index done, Index) {
      const auto now = std::chrono::steady_clock::now();
      if (now - shown < std::chrono::milliseconds(200)) return;
      shown = now;
      say('p', std::to_string(done));
    });
    say('r', mpi::bytes_of(result));
  } catch (const IoError& error) {
    say('f', mpi::bytes_of(error));
  } catch (const std::exception& error) {
    say('f', std::string("failed (") + error.what() + ")");
  }
  return mapper::exit_good;
}

std::atomic<bool> asked_to_end = false;

/// Ends this process without MPI, which would wait for processes that are lost.
[[noreturn]] void leave(int exit_code) {
  std::fflush(nullptr);
  std::_Exit(exit_code);
}

/// The worker itself stays until process 0 says that the job is done: MPI ends together.
void work(const mpi::Environment& environment, tasks::TaskExecutor& executor) {
  for (const int signal : {SIGINT, SIGTERM, SIGHUP}) std::signal(signal, [](int) { asked_to_end = true; });
  for (const int signal : {SIGPIPE, SIGXFSZ}) std::signal(signal, SIG_IGN);  // errors like any other, as in process 0
  mpi::MpiTransport transport(environment);
  const auto end = tasks::serve(transport, executor, [] { return asked_to_end.load(); });
  if (end == tasks::WorkerEnd::abandoned) leave(mapper::exit_good);
  if (end == tasks::WorkerEnd::quit) return;
  std::fprintf(stderr,
               "error: process %d\n  found: process 0 does not answer any more\n  do: run the same command again: "
               "it continues with the sessions that are done\n",
               environment.rank());
  leave(mapper::exit_internal);
}

int coordinate(const mpi::Environment& environment, tasks::TaskExecutor& executor, int argc, char** argv) {
  int exit_code = mapper::exit_internal;
  bool lost = false;
  {
    mpi::MpiTransport transport(environment);
    tasks::Coordinator coordinator(transport, executor);
    {
      mpi::RecordedSessions sessions(coordinator);
      exit_code = mapper::run_program(argc, argv, &sessions);
    }
    lost = coordinator.lost_any();
  }
  if (lost) leave(exit_code);
  return exit_code;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc == 4 && argv[1] == task_option) return do_task(argv[2], argv[3]);
  try {
    const mpi::Environment environment(argc, argv);
    if (environment.size() == 1) return mapper::run_program(argc, argv);
    const unsigned share =
        std::max(1U, std::thread::hardware_concurrency() / static_cast<unsigned>(environment.size_here()));
    // Process 0 maps, which no other can: its odometry takes what time is left.
    const char* const niceness = environment.rank() == 0 ? "10" : "0";
    tasks::ChildExecutor executor({std::filesystem::read_symlink("/proc/self/exe").string(), std::string(task_option),
                                   std::to_string(share), niceness});
    if (environment.rank() == 0) return coordinate(environment, executor, argc, argv);
    work(environment, executor);
    return mapper::exit_good;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "error: %s\n  found: MPI does not work\n  do: start the program by mpirun of the same MPI\n",
                 error.what());
    return mapper::exit_internal;
  }
}
