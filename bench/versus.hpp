#pragma once

#include <benchmark/benchmark.h>
#include <malloc.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <ctime>
#include <span>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace chainslam::bench {

/// Another program's way of doing the same.
template <class Run>
struct Peer {
  std::string name;  ///< as it stands in the counter's name: lower case, no blanks
  Run run;           ///< returns something that depends on all of its work
};
template <class Run>
Peer(const char*, Run) -> Peer<Run>;

/// The processor time of the calling thread, seconds: other programs on the machine do not count. For work on one
/// thread.
struct ThreadTime {
  static double now() {
    timespec time{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
    return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
  }
};

/// The time on the wall, seconds: for work on several threads, and for files.
struct WallTime {
  static double now() {
    return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
  }
};

/// Bytes that the program has asked for and not given back.
inline double heap_bytes() {
  const struct mallinfo2 info = mallinfo2();
  return static_cast<double>(info.uordblks) + static_cast<double>(info.hblkhd);
}

namespace detail {

template <class Time, class Run>
double seconds(Run& run, int repeats) {
  const double start = Time::now();
  for (int i = 0; i < repeats; ++i) benchmark::DoNotOptimize(run());
  return (Time::now() - start) / repeats;
}

inline double median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Runs of a few microseconds are repeated to last long enough for the clock.
template <class Time, class Run>
int repeats_for(Run& run) {
  constexpr double long_enough = 200e-6;
  const double once = std::max(seconds<Time>(run, 1), 1e-9);
  return static_cast<int>(std::clamp(std::ceil(long_enough / once), 1.0, 1e5));
}

}  // namespace detail

/// Times ours and the peers turn about, each iteration beginning with another one, so that noise hits all alike.
///
/// The bench's time is ours (use `UseManualTime()`), by `Time`: `versus<WallTime>(...)` where threads or files take
/// part. Counters: `speedup_vs_<peer>`, the median over iterations of the peer's time divided by ours of the same
/// iteration, which one preempted run cannot move; and `<peer>_ms`, the median time of the peer.
template <class Time = ThreadTime, class Ours, class... Runs>
void versus(benchmark::State& state, Ours&& ours, Peer<Runs>... peers) {
  constexpr std::size_t runners = sizeof...(Runs) + 1;
  const std::array<std::string, runners> names{"ours", peers.name...};
  const std::array<int, runners> repeats{detail::repeats_for<Time>(ours), detail::repeats_for<Time>(peers.run)...};
  std::array<std::vector<double>, runners> ratios, times;
  std::size_t turn = 0;
  for (auto _ : state) {
    std::array<double, runners> elapsed{};
    for (std::size_t i = 0; i < runners; ++i) {
      const std::size_t next = (turn + i) % runners;
      std::size_t runner = 0;
      const auto run_if_next = [&](auto& run) {
        if (runner == next) elapsed[runner] = detail::seconds<Time>(run, repeats[runner]);
        ++runner;
      };
      run_if_next(ours);
      (run_if_next(peers.run), ...);
    }
    ++turn;
    state.SetIterationTime(elapsed[0]);
    for (std::size_t i = 1; i < runners; ++i) {
      ratios[i].push_back(elapsed[i] / elapsed[0]);
      times[i].push_back(elapsed[i]);
    }
  }
  for (std::size_t i = 1; i < runners; ++i) {
    state.counters["speedup_vs_" + names[i]] = detail::median(ratios[i]);
    state.counters[names[i] + "_ms"] = 1e3 * detail::median(times[i]);
  }
}

/// `versus` with one peer.
template <class Time = ThreadTime, class Ours, class Theirs>
void versus(benchmark::State& state, const char* peer, Ours&& ours, Theirs&& theirs) {
  versus<Time>(state, std::forward<Ours>(ours), Peer<std::decay_t<Theirs>>{peer, std::forward<Theirs>(theirs)});
}

/// Throws, which ends the bench, unless both gave the same numbers up to `relative` (of the larger one) or `absolute`.
inline void require_same_answers(std::span<const double> ours, std::span<const double> theirs, double relative = 1e-5,
                                 double absolute = 1e-12) {
  if (ours.size() != theirs.size())
    throw std::runtime_error("answers differ: ours has " + std::to_string(ours.size()) + " numbers, the peer " +
                             std::to_string(theirs.size()));
  for (std::size_t i = 0; i < ours.size(); ++i) {
    const double tolerance = relative * std::max(std::abs(ours[i]), std::abs(theirs[i])) + absolute;
    if (std::abs(ours[i] - theirs[i]) <= tolerance) continue;
    std::ostringstream message;
    message.precision(17);
    message << "answers differ at number " << i << ": ours " << ours[i] << ", the peer " << theirs[i];
    throw std::runtime_error(message.str());
  }
}

}  // namespace chainslam::bench
