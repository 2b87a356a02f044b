#include "support/interrupt.hpp"

#include <fcntl.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cstring>
#include <stdexcept>
#include <system_error>

namespace chainslam::support {
namespace {

constexpr int exit_interrupted = 130;

std::atomic<bool> in_use = false;
std::atomic<int> pipe_end = -1;  // where the handler writes
std::atomic<int> signals_caught = 0;
std::atomic<const char*> message = nullptr;
static_assert(std::atomic<int>::is_always_lock_free && std::atomic<const char*>::is_always_lock_free,
              "a signal handler may touch lock-free atomics alone");

/// Runs inside the signal: only calls that POSIX allows there.
void on_signal(int /*signal*/) {
  const int saved_errno = errno;
  if (signals_caught.fetch_add(1) > 0) _exit(exit_interrupted);
  const char* text = message.load();
  [[maybe_unused]] ssize_t written = write(STDERR_FILENO, text, std::strlen(text));
  written = write(pipe_end.load(), "!", 1);
  errno = saved_errno;
}

}  // namespace

Interrupt::Interrupt(const char* text) {
  if (in_use.exchange(true)) throw std::logic_error("only one Interrupt at a time");
  if (pipe2(pipe_, O_CLOEXEC) != 0) {
    in_use = false;
    throw std::system_error(errno, std::generic_category(), "a pipe for signals");
  }
  signals_caught = 0;
  message = text;
  pipe_end = pipe_[1];
  watcher_ = std::jthread([source = source_, read_end = pipe_[0]]() mutable {
    char byte = 0;
    ssize_t got = 0;
    do got = read(read_end, &byte, 1);
    while (got < 0 && errno == EINTR);
    if (got == 1 && byte == '!') source.request_stop();
  });
  struct sigaction action {};
  action.sa_handler = on_signal;
  sigemptyset(&action.sa_mask);
  action.sa_flags = SA_RESTART;
  sigaction(SIGINT, &action, &former_interrupt_);
  sigaction(SIGTERM, &action, &former_terminate_);
  sigaction(SIGHUP, &action, &former_hang_up_);
}

Interrupt::~Interrupt() {
  sigaction(SIGINT, &former_interrupt_, nullptr);
  sigaction(SIGTERM, &former_terminate_, nullptr);
  sigaction(SIGHUP, &former_hang_up_, nullptr);
  pipe_end = -1;
  close(pipe_[1]);  // the watcher reads the end of the pipe, and ends
  watcher_.join();
  close(pipe_[0]);
  in_use = false;
}

}  // namespace chainslam::support
