#pragma once

#include <fcntl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstddef>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "program/run_program.hpp"

namespace chainslam::test {

using Clock = std::chrono::steady_clock;

/// Seconds after which a program that is to end at once hangs: a machine under load takes one or two.
constexpr double hung = 10;

/// The program, running beside the test; its errors go to a file.
class Running {
 public:
  Running(const std::vector<std::string>& arguments, const fs::path& errors) {
    std::vector<char*> argv;
    std::vector<std::string> all = arguments;
    all.insert(all.begin(), CHAINSLAM_PROGRAM);
    for (std::string& argument : all) argv.push_back(argument.data());
    argv.push_back(nullptr);
    pid_ = ::fork();
    if (pid_ != 0) return;
    const int file = ::open(errors.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0666), null = ::open("/dev/null", O_WRONLY);
    ::dup2(null, 1);
    ::dup2(file, 2);
    ::execv(argv[0], argv.data());
    ::_exit(127);
  }
  Running(const Running&) = delete;
  Running& operator=(const Running&) = delete;
  ~Running() {
    if (pid_ > 0) {
      ::kill(pid_, SIGKILL);
      static_cast<void>(wait());
    }
  }

  /// Nothing once it has ended: its number may be another's, and -1 would be every process there is.
  void signal(int number) const {
    if (pid_ > 0) ::kill(pid_, number);
  }

  /// Waits for its end. @returns its exit code, 128 + number if a signal ended it.
  int wait() {
    int status = 0;
    ::waitpid(pid_, &status, 0);
    return ended(status);
  }

  /// The same for so many seconds. @returns nothing if it still runs.
  std::optional<int> wait_for(double seconds) {
    const auto begin = std::chrono::steady_clock::now();
    int status = 0;
    while (::waitpid(pid_, &status, WNOHANG) == 0) {
      if (std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count() > seconds)
        return std::nullopt;
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
    return ended(status);
  }

 private:
  int ended(int status) {
    pid_ = -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }

  ::pid_t pid_ = -1;
};

inline double seconds_since(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

/// Within a second in the median: single moments of load do not show in it.
inline bool mostly_within_a_second(std::vector<double> seconds) {
  const auto middle = seconds.begin() + static_cast<std::ptrdiff_t>(seconds.size() / 2);
  std::nth_element(seconds.begin(), middle, seconds.end());
  return *middle < 1;
}

inline void sleep_for(double seconds) { std::this_thread::sleep_for(std::chrono::duration<double>(seconds)); }

}  // namespace chainslam::test
