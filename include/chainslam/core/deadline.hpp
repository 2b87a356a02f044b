#pragma once

#include <chrono>
#include <stop_token>
#include <utility>

namespace chainslam {

/// When to stop: at a time, or on request. Default: never.
///
/// What takes one looks at it between pieces of work that last milliseconds, then returns what it has and says that it
/// was cut short. Whether it comes to that depends on the clock; all else does not.
class Deadline {
 public:
  using Clock = std::chrono::steady_clock;  ///< the clock that it is read on

  Deadline() = default;
  /// Passes at `time`, or when a stop is requested.
  explicit Deadline(Clock::time_point time, std::stop_token stop = {}) : time_(time), stop_(std::move(stop)) {}
  explicit Deadline(std::stop_token stop) : stop_(std::move(stop)) {}  ///< passes when a stop is requested
  /// That long from now.
  [[nodiscard]] static Deadline in(Clock::duration duration, std::stop_token stop = {}) {
    return Deadline(Clock::now() + duration, std::move(stop));
  }

  /// Whether the time has come, or a stop was requested.
  [[nodiscard]] bool passed() const {
    return stop_.stop_requested() || (time_ != Clock::time_point::max() && Clock::now() >= time_);
  }

 private:
  Clock::time_point time_ = Clock::time_point::max();
  std::stop_token stop_;
};

}  // namespace chainslam
