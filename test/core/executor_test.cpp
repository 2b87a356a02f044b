#include "chainslam/core/executor.hpp"

#include <doctest/doctest.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "chainslam/core/thread_pool.hpp"
#include "support/property.hpp"
#include "support/threads_cases.hpp"

namespace chainslam {
namespace {

struct WithoutGrain {
  void for_chunks(Index, void (*)(Index, Index)) const {}
};
static_assert(!Executor<WithoutGrain> && !Executor<int>);

struct Failure {
  Index chunk;
};

/// A sum whose bits depend on the order of additions.
template <class E>
double harmonic_sum(const E& executor, Index count, Index grain) {
  return reduce_chunks(
      executor, count, grain, 0.0,
      [](Index begin, Index end) {
        double sum = 0.0;
        for (Index i = begin; i < end; ++i) sum += 1.0 / (i + 1) - std::sqrt(i + 0.5);
        return sum;
      },
      [](double left, double right) { return left + right; });
}

template <class E>
void check_each_index_once(const E& executor, Index count, Index grain) {
  std::vector<std::atomic<int>> visits(static_cast<std::size_t>(count));
  executor.for_chunks(count, grain, [&](Index begin, Index end) {
    CHECK(begin % grain == 0);
    CHECK(end == std::min(count, begin + grain));
    for (Index i = begin; i < end; ++i) ++visits[static_cast<std::size_t>(i)];
  });
  for (const auto& visit : visits) CHECK(visit == 1);
}

/// Chunks 5, 9 and all beyond 20 fail, the early ones late.
template <class E>
Index first_failure(const E& executor) {
  try {
    executor.for_chunks(64, 1, [](Index begin, Index) {
      if (begin == 5) std::this_thread::sleep_for(std::chrono::milliseconds(5));
      if (begin == 5 || begin == 9 || begin > 20) throw Failure{begin};
    });
  } catch (const Failure& failure) {
    return failure.chunk;
  }
  return -1;
}

TEST_SUITE("core/executor") {
  THREADS_TEST_CASE("core/executor", "a reduction has the same bits on no, one, two and eight threads") {
    for (const Index grain : {1, 7, 64, 100'000}) {
      const double expected = harmonic_sum(Serial{}, 10'000, grain);
      for (const Index threads : {0, 1, 2, 8}) {
        const ThreadPool pool(threads);
        for (int repeat = 0; repeat < 20; ++repeat) CHECK(harmonic_sum(pool, 10'000, grain) == expected);
      }
    }
  }

  THREADS_TEST_CASE("core/executor", "every index is visited once, whatever count and grain") {
    const ThreadPool pool(4);
    test::for_all(100, [&](Rng& rng, int size) {
      const Index count = rng.uniform_index(static_cast<Index>(10 * size));
      const Index grain = 1 + rng.uniform_index(static_cast<Index>(size));
      check_each_index_once(Serial{}, count, grain);
      check_each_index_once(pool, count, grain);
    });
  }

  THREADS_TEST_CASE("core/executor", "counts and grains up to the largest index do not overflow") {
    const ThreadPool pool(2);
    constexpr Index largest = std::numeric_limits<Index>::max();
    const auto visited = [&](const auto& executor, Index grain) {
      std::atomic<std::int64_t> sum = 0;
      executor.for_chunks(largest, grain, [&](Index begin, Index end) { sum += end - begin; });
      return sum.load();
    };
    for (const Index grain : {largest, largest - 1, largest / 2 + 1, 1 << 20}) {
      CHECK(visited(Serial{}, grain) == largest);
      CHECK(visited(pool, grain) == largest);
    }
  }

  THREADS_TEST_CASE("core/executor", "nothing to do is done at once") {
    const ThreadPool pool(2);
    for (const Index count : {0, -1}) {
      pool.for_chunks(count, 8, [](Index, Index) { FAIL("no chunk was asked for"); });
      CHECK(harmonic_sum(pool, count, 8) == 0.0);
      CHECK(harmonic_sum(Serial{}, count, 8) == 0.0);
    }
  }

  THREADS_TEST_CASE("core/executor", "a grain below one is refused") {
    const auto nothing = [](Index, Index) {};
    CHECK_THROWS_AS(Serial{}.for_chunks(10, 0, nothing), std::invalid_argument);
    CHECK_THROWS_AS(ThreadPool(2).for_chunks(10, 0, nothing), std::invalid_argument);
    CHECK_THROWS_AS(ThreadPool(2).for_chunks(10, -3, nothing), std::invalid_argument);
  }

  THREADS_TEST_CASE("core/executor", "the first failure in chunk order is rethrown, and the pool goes on working") {
    CHECK(first_failure(Serial{}) == 5);
    for (const Index threads : {1, 2, 8}) {
      const ThreadPool pool(threads);
      for (int repeat = 0; repeat < 10; ++repeat) CHECK(first_failure(pool) == 5);
      check_each_index_once(pool, 100, 3);
    }
  }

  THREADS_TEST_CASE("core/executor", "loops nest, and failures come out of both") {
    const ThreadPool pool(3);
    std::atomic<int> visits = 0;
    pool.for_chunks(10, 1, [&](Index, Index) { pool.for_chunks(10, 1, [&](Index, Index) { ++visits; }); });
    CHECK(visits == 100);
    CHECK_THROWS_AS(pool.for_chunks(4, 1,
                                    [&](Index, Index) {
                                      pool.for_chunks(4, 1, [](Index, Index) { throw std::runtime_error("inner"); });
                                    }),
                    std::runtime_error);
  }

  THREADS_TEST_CASE("core/executor", "several threads may share one pool") {
    const ThreadPool pool(3);
    const double expected = harmonic_sum(Serial{}, 2'000, 16);
    std::atomic<int> agreed = 0;
    {
      std::vector<std::jthread> callers;
      for (int caller = 0; caller < 4; ++caller)
        callers.emplace_back([&] {
          for (int repeat = 0; repeat < 50; ++repeat) agreed += harmonic_sum(pool, 2'000, 16) == expected;
        });
    }
    CHECK(agreed == 200);
  }

  THREADS_TEST_CASE("core/executor", "several threads do work on one loop") {
    const ThreadPool pool(2);
    REQUIRE(pool.threads() == 2);
    // Each of the two chunks waits until the other has begun: one thread alone would never end.
    std::atomic<int> begun = 0;
    pool.for_chunks(2, 1, [&](Index, Index) {
      ++begun;
      while (begun < 2) std::this_thread::yield();
    });
    CHECK(begun == 2);
  }

  THREADS_TEST_CASE("core/executor", "two calls are both made, at the same time where there are threads") {
    std::string made;
    call_both(
        Serial{}, [&] { made += "first "; }, [&] { made += "second"; });
    CHECK(made == "first second");
    const ThreadPool pool(2);
    std::atomic<int> begun = 0;
    const auto wait_for_the_other = [&] {
      ++begun;
      while (begun < 2) std::this_thread::yield();
    };
    call_both(pool, wait_for_the_other, wait_for_the_other);
    CHECK(begun == 2);
  }

  THREADS_TEST_CASE("core/executor", "pools of none and one run on the caller") {
    const auto caller = std::this_thread::get_id();
    for (const Index threads : {0, 1, -4}) {
      const ThreadPool pool(threads);
      CHECK(pool.threads() == 1);
      pool.for_chunks(10, 1, [&](Index, Index) { CHECK(std::this_thread::get_id() == caller); });
    }
  }
}

}  // namespace
}  // namespace chainslam
