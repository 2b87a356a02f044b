#pragma once

#include <ctime>
#include <string>
#include <vector>

#include "search/structure.hpp"
#include "versus.hpp"

namespace chainslam::bench {

/// How long something took, seconds: the processor time of this thread, by which figures are given, and the time on the
/// wall, which has the waiting for another thread's locks, but also other programs.
struct Elapsed {
  double thread = 0;
  double wall = 0;

  Elapsed& operator+=(const Elapsed& other) {
    thread += other.thread;
    wall += other.wall;
    return *this;
  }
};

template <class Run>
Elapsed measure(Run&& run) {
  const double wall = WallTime::now(), thread = ThreadTime::now();
  run();
  const double thread_after = ThreadTime::now();
  return {thread_after - thread, WallTime::now() - wall};
}

/// The processor time of all threads of this program but the calling one, seconds.
inline double helpers_time() {
  timespec time{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec) - ThreadTime::now();
}

/// `versus` for structures: ours first, then the peers; `seconds_of(i)` does the work of the i-th and says how long it
/// took. Sets the bench's time and the counters `speedup_vs_<peer>` and `<peer>_ms`.
template <class SecondsOf>
void contest(benchmark::State& state, const std::vector<Maker>& makers, SecondsOf&& seconds_of) {
  std::vector<std::vector<double>> ratios(makers.size()), times(makers.size());
  std::vector<double> elapsed(makers.size());
  std::size_t turn = 0;
  for (auto _ : state) {
    for (std::size_t i = 0; i < makers.size(); ++i) {
      const std::size_t next = (turn + i) % makers.size();
      elapsed[next] = seconds_of(next);
    }
    ++turn;
    state.SetIterationTime(elapsed[0]);
    for (std::size_t i = 1; i < makers.size(); ++i) {
      ratios[i].push_back(elapsed[i] / elapsed[0]);
      times[i].push_back(elapsed[i]);
    }
  }
  for (std::size_t i = 1; i < makers.size(); ++i) {
    state.counters["speedup_vs_" + makers[i].name] = detail::median(ratios[i]);
    state.counters[makers[i].name + "_ms"] = 1e3 * detail::median(times[i]);
  }
}

}  // namespace chainslam::bench
