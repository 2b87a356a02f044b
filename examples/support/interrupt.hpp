#pragma once

#include <csignal>
#include <stop_token>
#include <thread>

namespace chainslam::support {

/// Turns Ctrl-C (and SIGTERM, and SIGHUP: the terminal was closed) into a stop request while it lives: the first
/// finishes what is whole and saves it, the second ends the program at once with exit code 130. One at a time.
class Interrupt {
 public:
  /// @param message  shown at the first signal; must outlive all signals.
  /// @throws std::logic_error if there is one already; std::system_error if the system gives no pipe.
  explicit Interrupt(const char* message = finishing);
  Interrupt(const Interrupt&) = delete;
  Interrupt& operator=(const Interrupt&) = delete;
  /// Puts the former handlers back.
  ~Interrupt();

  /// Wakes and stops whoever waits with it.
  [[nodiscard]] std::stop_token token() const { return source_.get_token(); }
  [[nodiscard]] bool requested() const { return source_.stop_requested(); }

 private:
  static constexpr const char* finishing =
      "\nfinishing the current keyframe; press again to stop at once (nothing saved so far is lost)\n";

  std::stop_source source_;
  int pipe_[2] = {-1, -1};
  struct sigaction former_interrupt_ {};
  struct sigaction former_terminate_ {};
  struct sigaction former_hang_up_ {};
  std::jthread watcher_;  ///< a signal handler may not ask for a stop; this thread may
};

}  // namespace chainslam::support
