#pragma once

#include <chrono>
#include <concepts>
#include <cstddef>
#include <stdexcept>
#include <stop_token>
#include <utility>
#include <vector>

#include "chainslam/core/types.hpp"

namespace chainslam {

/// Runs the chunks of a loop.
///
/// `for_chunks(count, grain, body)` calls `body(begin, end)` once for each chunk [c * grain, min((c + 1) * grain,
/// count)) and returns when all are done. Chunks depend on `count` and `grain` alone, never on the number of threads;
/// they may run at the same time and in any order. The exception of the first chunk, in chunk order, that throws is
/// rethrown; chunks after it may be left out. A grain below 1 is a std::invalid_argument.
template <class E>
concept Executor = requires(const E& executor, Index count, Index grain, void (*body)(Index, Index)) {
  executor.for_chunks(count, grain, body);
};

namespace detail {

inline void require_grain(Index grain) {
  if (grain < 1) throw std::invalid_argument("for_chunks: grain must be at least 1");
}

/// Number of chunks of `grain` that cover `count`.
[[nodiscard]] constexpr Index count_chunks(Index count, Index grain) {
  return count <= 0 ? 0 : (count - 1) / grain + 1;
}

}  // namespace detail

/// Runs the chunks one after the other on the calling thread.
struct Serial {
  /// Calls body(begin, end) for all chunks of at most `grain` indices, in order.
  template <std::invocable<Index, Index> Body>
  void for_chunks(Index count, Index grain, Body&& body) const {
    detail::require_grain(grain);
    for (Index begin = 0; begin < count;) {
      const Index end = count - begin > grain ? begin + grain : count;
      body(begin, end);
      begin = end;
    }
  }
};
static_assert(Executor<Serial>);

/// Reduces chunks in chunk order, so that any executor and any number of threads give bit-identical results.
///
/// @param chunk    `T chunk(Index begin, Index end)`: the partial result of one chunk.
/// @param combine  `T combine(T left, T right)`: joins two partial results; applied from the first chunk to the last.
template <class T, Executor E, std::invocable<Index, Index> Chunk, class Combine>
[[nodiscard]] T reduce_chunks(const E& executor, Index count, Index grain, T identity, Chunk&& chunk,
                              Combine&& combine) {
  detail::require_grain(grain);
  std::vector<T> partial(static_cast<std::size_t>(detail::count_chunks(count, grain)), identity);
  executor.for_chunks(count, grain, [&](Index begin, Index end) {
    partial[static_cast<std::size_t>(begin / grain)] = chunk(begin, end);
  });
  T result = std::move(identity);
  for (T& part : partial) result = combine(std::move(result), std::move(part));
  return result;
}

/// Calls both, at the same time where the executor has threads for it.
template <Executor E, std::invocable First, std::invocable Second>
void call_both(const E& executor, First&& first, Second&& second) {
  executor.for_chunks(2, 1, [&](Index begin, Index /*end*/) {
    if (begin == 0)
      first();
    else
      second();
  });
}

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
