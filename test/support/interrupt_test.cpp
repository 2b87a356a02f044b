#include "support/interrupt.hpp"

#include <doctest/doctest.h>
#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <csignal>
#include <cstdio>
#include <stdexcept>
#include <thread>

#include "chainslam/core/channel.hpp"

namespace chainslam::support {
namespace {

/// Exit code of a child process that does this, with its messages unseen.
template <class Action>
int exit_code_of(Action&& action) {
  std::fflush(nullptr);  // or the child prints it again
  const pid_t child = fork();
  REQUIRE(child >= 0);
  if (child == 0) {
    dup2(open("/dev/null", O_WRONLY), STDERR_FILENO);
    action();
    _exit(0);
  }
  int status = 0;
  waitpid(child, &status, 0);
  return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
}

TEST_SUITE("support/interrupt") {
  TEST_CASE("the first signal asks for a stop and wakes who waits") {
    CHECK(exit_code_of([] {
            Interrupt interrupt;
            Channel<int> never_filled(1);
            std::jthread sender([] {
              std::this_thread::sleep_for(std::chrono::milliseconds(20));
              kill(getpid(), SIGINT);
            });
            const bool got = never_filled.pop(interrupt.token()).has_value();
            _exit(!got && interrupt.requested() ? 42 : 1);
          }) == 42);
  }

  TEST_CASE("the second signal ends the program at once with exit code 130") {
    CHECK(exit_code_of([] {
            const Interrupt interrupt;
            kill(getpid(), SIGINT);
            kill(getpid(), SIGINT);
            std::this_thread::sleep_for(std::chrono::seconds(10));
          }) == 130);
  }

  TEST_CASE("SIGTERM asks for a stop too") {
    CHECK(exit_code_of([] {
            const Interrupt interrupt;
            kill(getpid(), SIGTERM);
            while (!interrupt.requested()) std::this_thread::yield();
            _exit(43);
          }) == 43);
  }

  TEST_CASE("the former handlers come back, and nothing is asked when no signal came") {
    {
      const Interrupt interrupt;
      CHECK_FALSE(interrupt.requested());
      CHECK_THROWS_AS(Interrupt(), std::logic_error);
    }
    CHECK(exit_code_of([] {
            std::signal(SIGTERM, SIG_DFL);  // the test framework has its own
            { const Interrupt interrupt; }
            kill(getpid(), SIGTERM);
            std::this_thread::sleep_for(std::chrono::seconds(10));
          }) == -SIGTERM);
    const Interrupt again;
    CHECK_FALSE(again.requested());
  }
}

}  // namespace
}  // namespace chainslam::support
